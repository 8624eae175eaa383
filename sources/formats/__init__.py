"""Captures in other tools' formats: one module each, found by what a file holds, not by its name.

A format is a module with `NAME`, `why_not(head) -> reason or None` and `open_capture(path) -> Capture`; it
joins by its line in `FORMATS`.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import HEAD_BYTES, Capture

FORMATS = (
    "npz",
    "npy",
    "matlab",
    "hdf5",
    "tfrecord",
    "nexmon",
    "picoscenes",
    "esp32",
    "intel5300",
    "atheros",
)
"""Modules of this package, in the order in which they are asked."""


def open_capture(path: Path) -> Capture:
    """The capture in `path`, whatever its format.

    Raises
    ------
    SetupError
        If it cannot be read or is in no known format; the message has every format's reason.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise SetupError(f"{path} cannot be read: {error.strerror}") from None
    reasons = []
    for name in FORMATS:
        module = import_module(f"{__name__}.{name}")
        reason = module.why_not(head)
        if reason is None:
            capture: Capture = module.open_capture(path)
            return capture
        reasons.append(f"not {module.NAME}: {reason}")
    raise SetupError(f"{path} is in no format that can be imported ({'; '.join(reasons)})")
