"""The feeder process: the source, the CSI sinks, and the dispatcher."""

from __future__ import annotations

import logging
import sys

import zmq

from chachart.node.data.errors import EX_CONFIG, SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.security import SecuritySettings
from chachart.node.runtime import messages
from chachart.node.runtime.child import load_class, read_settings
from chachart.node.runtime.dispatcher import Dispatcher, StartOver

log = logging.getLogger(__name__)

START_OVER = 75
"""Exit status of a feeder that has to begin anew (EX_TEMPFAIL of sysexits.h)."""
SWITCH_INTERVAL_S = 0.0005
"""The reader must not keep the dispatcher waiting for the interpreter as long as Python's 5 ms."""


def main() -> int:
    """Run as `python -m chachart.node.runtime.feeder`, settings on stdin."""
    settings = read_settings()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    context = zmq.Context()
    results = context.socket(zmq.PUSH)
    results.connect(settings["sockets"]["results"])
    try:
        source_class = load_class(settings["source"]["class"])
        source_settings = source_class.Settings.model_validate(settings["source"]["settings"])
        source = source_class(source_settings, ArrayGeometry.from_dict(settings["array"]))
        source.others = tuple(ArrayGeometry.from_dict(other) for other in settings["others"])
        source.security = SecuritySettings.model_validate(settings["security"])
        Dispatcher(settings, source, context, results).run()
    except StartOver as reason:
        log.warning("%s; starting over", reason)
        return START_OVER
    except SetupError as error:
        results.send_multipart([messages.SETUP_ERROR, messages.pack({"message": str(error)})])
        return EX_CONFIG
    finally:
        context.destroy(linger=2000)
    return 0


if __name__ == "__main__":
    sys.exit(main())
