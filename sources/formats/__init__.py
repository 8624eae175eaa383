"""Captures in other tools' formats: one module each, found by what a file holds, not by its name.

A format is a module with `NAME`, `why_not(head) -> reason or None` and `open_capture(path) -> Capture`; it
joins by its line in `FORMATS`.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from weakref import finalize

from chachart.node.data.errors import SetupError
from chachart.sources.formats.base import HEAD_BYTES, Capture
from chachart.sources.formats.packed import is_packed, unpacked

FORMATS = (
    "npz",
    "npy",
    "matlab",
    "hdf5",
    "tfrecord",
    "wifi.nexmon",
    "wifi.picoscenes",
    "wifi.intel5300",
    "wifi.atheros",
    "wifi.feitcsi",
    "wifi.esp32",
)
"""Modules of this package, in the order in which they are asked."""


SAMPLE = Path("sample.npz")
"""A capture that comes with chachart: 16 UEs that walk before a line of 8 antennas, 15 frames each."""


def open_capture(path: Path) -> Capture:
    """The capture in `path`, whatever its format; `sample.npz` is `SAMPLE` where there is no such file.

    Raises
    ------
    SetupError
        If it cannot be read or is in no known format; the message has every format's reason.
    """
    if path == SAMPLE and not path.exists():
        path = Path(__file__).with_name(path.name)
    head = _head(path)
    if is_packed(head):
        held = unpacked(path, head)
        try:
            capture = _opened(Path(held.name), _head(Path(held.name)), path)
        except BaseException:
            held.close()
            raise
        finalize(capture, held.close)
        return capture
    return _opened(path, head, path)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise SetupError(f"{path} cannot be read: {error.strerror}") from None


def _opened(path: Path, head: bytes, name: Path) -> Capture:
    """The capture in `path`, which messages call `name`."""
    reasons = []
    for known in FORMATS:
        module = import_module(f"{__name__}.{known}")
        reason = module.why_not(head)
        if reason is None:
            try:
                capture: Capture = module.open_capture(path)
            except SetupError as error:
                raise SetupError(str(error).replace(str(path), str(name))) from None
            except MemoryError:
                raise SetupError(f"{name} needs more memory than there is") from None
            return capture
        reasons.append(f"not {module.NAME}: {reason}")
    raise SetupError(f"{name} is in no format that can be imported ({'; '.join(reasons)})")
