"""Captures that gzip or bzip2 has packed: unpacked to a file that goes away with the capture."""

from __future__ import annotations

import bz2
import gzip
import tempfile
import zlib
from pathlib import Path
from typing import IO, Any, cast

from chachart.node.data.errors import SetupError

_MAGICS = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open}
_DENSEST, _ALWAYS = 200, 64 << 20
"""Files may grow to so many times their size, and to so many bytes in any case; CSI packs far worse."""
_PIECE = 1 << 20


def is_packed(head: bytes) -> bool:
    """Whether a file that begins with `head` is packed."""
    return any(head.startswith(magic) for magic in _MAGICS)


def unpacked(path: Path, head: bytes) -> IO[bytes]:
    """The content of `path` in a temporary file, which is deleted when it is closed.

    Raises
    ------
    SetupError
        If it is damaged, or claims to be far too large.
    """
    opener: Any = next(opener for magic, opener in _MAGICS.items() if head.startswith(magic))
    room = max(_ALWAYS, _DENSEST * path.stat().st_size)
    target = tempfile.NamedTemporaryFile(prefix="chachart-", suffix=f"-{path.stem}")  # noqa: SIM115
    try:
        with opener(path, "rb") as source:
            while piece := source.read(_PIECE):
                room -= len(piece)
                if room < 0:
                    raise SetupError(f"{path} unpacks to more than {_DENSEST} times its size")
                target.write(piece)
        target.flush()
    except (EOFError, OSError, zlib.error, ValueError) as error:
        if target.tell() == 0 or not isinstance(error, EOFError):
            target.close()
            raise SetupError(f"{path} cannot be unpacked: {error}") from None
        target.flush()  # cut short: what there is of it may be whole frames
    except BaseException:
        target.close()
        raise
    return cast(IO[bytes], target)
