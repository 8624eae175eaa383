"""Be an array front-end: send a scenario or a recording over a serial line or a CAN bus, faults included.

chachart frontend --serial pty:/tmp/front-end                    the scenario of lab.toml
chachart frontend capture.mcap --serial /dev/ttyUSB1             a recording, at its own pace
chachart frontend --can udp_multicast:239.74.163.2 --drop 0.01   one frame in a hundred is lost

With --serial pty a pseudo-terminal is made and its name printed; pty:PATH gives it a name of your own. At the
end, or on Ctrl-C, it says what became of every frame.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from chachart.config.load import load
from chachart.config.registry import source_class
from chachart.config.settings import ArraySettings
from chachart.node.data.errors import SetupError
from chachart.sources.base import Source
from chachart.sources.frontend.can import CanSettings
from chachart.sources.frontend.device import FaultSettings, Link, Report, SimulatedFrontEnd
from chachart.sources.frontend.loopback import LoopbackSettings, loopback_settings
from chachart.sources.frontend.serial import SerialSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart frontend`."""
    parser.add_argument("recording", type=Path, nargs="?", metavar="FILE.mcap", help="what to play")
    link = parser.add_mutually_exclusive_group(required=True)
    link.add_argument("--serial", metavar="PORT", help="a serial port, pty, or pty:PATH")
    link.add_argument("--can", metavar="INTERFACE:CHANNEL", help="a CAN bus of python-can")
    parser.add_argument("--config", type=Path, metavar="TOML", help="array and scenario; default lab.toml")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change the config")
    parser.add_argument("--speed", type=float, default=1.0, help="of a recording; 0: as fast as possible")
    parser.add_argument("--baudrate", type=int, default=921_600, help="of a serial port")
    parser.add_argument("--id", type=_integer, default=0x640, help="CAN identifier to send on")
    parser.add_argument("--reply-id", type=_integer, default=0x648, help="CAN identifier of its answers")
    parser.add_argument("--classic", action="store_true", help="classic CAN, not CAN FD")
    parser.add_argument("--option", action="append", default=[], metavar="KEY=VALUE", help="for python-can")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    for name, field in FaultSettings.model_fields.items():
        kind = float if field.annotation in (float, float | None) else int if field.annotation is int else str
        parser.add_argument(
            "--" + name.replace("_", "-"),
            type=kind,
            default=field.default,
            metavar={float: "X", int: "N"}.get(kind, "WORD"),
            help=(field.description or "").replace("%", "%%"),
        )


def run(arguments: argparse.Namespace) -> int:
    """Play to the end.

    Raises
    ------
    SetupError
        If the configuration, the recording or the link is not usable.
    """
    try:
        faults = FaultSettings.model_validate(
            {name: getattr(arguments, name) for name in FaultSettings.model_fields}
        )
        source = _source(arguments)
        link = _link(arguments)
    except ValidationError as error:
        first = error.errors()[0]
        option = str(first["loc"][0]).replace("_", "-") if first["loc"] else "id"
        option = "can" if option in ("interface", "channel") else option
        raise SetupError(f"--{option}: {first['msg']}") from None
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: link.stopping.set())
    print(f"front-end on {link.where}", flush=True)
    device = SimulatedFrontEnd(source, link, faults)
    try:
        report = device.run()
        link.unplug()
    finally:
        link.close()
    _print(report, arguments.json)
    return 0


def _source(arguments: argparse.Namespace) -> Source:
    """The recording, or the configuration's source: a loopback's scenario where it has one."""
    if arguments.recording is not None:
        cls = source_class("recording")
        table = {"type": "recording", "path": arguments.recording, "speed": arguments.speed}
        settings, array = cls.Settings.model_validate(table), None
    else:
        configuration = load(arguments.config, arguments.set)
        settings, array = configuration.source, configuration.array
        if isinstance(settings, SerialSettings | CanSettings):
            settings = (loopback_settings(settings.loopback) or LoopbackSettings()).scenario
        cls = source_class(settings.type)
    carried = cls.carried_array(settings)
    return cls(settings, carried or (array or ArraySettings()).geometry())


def _link(arguments: argparse.Namespace) -> Link:
    from chachart.node.data.extras import require

    if arguments.serial is not None:
        require("serial", "chachart frontend:")
        from chachart.sources.frontend.serial_link import PortLink, PtyLink

        if arguments.serial != "pty" and not arguments.serial.startswith("pty:"):
            return PortLink(arguments.serial, arguments.baudrate)
        path = arguments.serial.removeprefix("pty").removeprefix(":")
        return PtyLink(Path(path) if path else None)
    require("can", "chachart frontend:")
    from chachart.sources.frontend.address import FrontEndAddress, distinct
    from chachart.sources.frontend.can_bus import CanBusSettings
    from chachart.sources.frontend.can_link import CanLink

    interface, colon, channel = arguments.can.partition(":")
    if not colon:
        raise SetupError(f"--can {arguments.can}: must be INTERFACE:CHANNEL, such as socketcan:can0")
    address = FrontEndAddress(id=arguments.id, reply_id=arguments.reply_id)
    try:
        distinct((address,))
    except ValueError as error:
        raise SetupError(f"--id, --reply-id: {error}") from None
    settings = CanBusSettings(
        type="can",
        interface=interface,
        channel=channel,
        fd=not arguments.classic,
        options=dict(_option(text) for text in arguments.option),
    )
    return CanLink(settings, address)


def _option(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise SetupError(f"--option {text}: must be KEY=VALUE")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def _integer(text: str) -> int:
    return int(text, 0)


def _print(report: Report, as_json: bool) -> None:
    if as_json:
        print(json.dumps(asdict(report)))
        return
    for name, n in asdict(report).items():
        print(f"{name:<10} {n}")
    sys.stdout.flush()
