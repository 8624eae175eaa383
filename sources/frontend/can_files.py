"""Logs of CAN buses as messages, with what is damaged in them counted and passed over."""

from __future__ import annotations

import itertools
import re
import struct
import zlib
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, cast

from chachart.node.data.counters import Counters

if TYPE_CHECKING:
    import can

SUFFIXES = (".blf", ".asc", ".log")
"""The formats of python-can that keep CAN FD messages whole."""
_OBJECT = b"LOBJ"
"""What each object of a .blf file begins with."""
_STAMP = re.compile(r"(\s*)(\d+(?:\.\d+)?)(?=\s)")
_CANDUMP = re.compile(r"(\s*\()(\d+\.\d+)(?=\))")
_AHEAD = 256
"""Lines of a candump log that decide whether its stamps are differences."""
_SINCE_1970_S = 1e8
"""Absolute stamps of a real bus are larger."""
_RELATIVE = re.compile(r"base\s+(hex|dec)\s+timestamps\s+relative", re.IGNORECASE)


def unreadable() -> tuple[type[Exception], ...]:
    """What python-can's readers raise on files that are damaged or something else."""
    import can
    from can.io.blf import BLFParseError

    plain = (ValueError, LookupError, TypeError, OverflowError, EOFError, OSError, struct.error, zlib.error)
    return (*plain, BLFParseError, can.CanError)


def channel_of(path: Path, message: can.Message) -> str:
    """The channel of a message as its file has it: python-can counts those of .asc and .blf from 0."""
    if isinstance(message.channel, int) and path.suffix.lower() != ".log":
        return str(message.channel + 1)
    return "" if message.channel is None else str(message.channel)


def messages(path: Path, file: IO[Any], rejected: Counters) -> Iterator[can.Message]:
    """The messages of an open log: .blf binary, the others text.

    A line that cannot be read is counted as `damaged_line`, an object of a .blf file as `damaged_object`.
    """
    import can

    suffix = path.suffix.lower()
    if suffix == ".blf":
        return _objects(can.BLFReader(cast(BinaryIO, file)), file, rejected)
    lines = _Lines(file, candump=suffix == ".log")
    reader: Any = can.ASCReader if suffix == ".asc" else can.CanutilsLogReader
    made = reader(lines, relative_timestamp=False) if suffix == ".asc" else reader(lines)
    return _of_lines(made, lines, rejected)


def _of_lines(reader: Any, lines: _Lines, rejected: Counters) -> Iterator[can.Message]:
    bad = unreadable()
    waiting = iter(reader)
    while True:
        try:
            yield next(waiting)
        except StopIteration:
            return
        except bad:
            rejected.add("damaged_line")
            # A new iteration of ASCReader looks for a header first, which an empty line ends.
            lines.push("\n")
            waiting = iter(reader)


def _objects(reader: Any, file: IO[bytes], rejected: Counters) -> Iterator[can.Message]:
    bad = unreadable()
    waiting = iter(reader)
    while True:
        try:
            yield next(waiting)
        except StopIteration:
            return
        except bad:
            rejected.add("damaged_object")
            if not _found(file):
                return
            waiting = iter(reader)


def _found(file: IO[bytes]) -> bool:
    """Whether there is another object in what follows; the file then stands at its beginning."""
    held = b""
    while piece := file.read(1 << 16):
        held = held[-len(_OBJECT) + 1 :] + piece
        at = held.find(_OBJECT)
        if at >= 0:
            file.seek(at - len(held), 1)
            return True
    return False


class _Lines:
    """A text file for python-can, whose stamps are absolute where the file has differences.

    An .asc file says so; of candump's (`-t d`) the stamps tell, since they do not grow.
    """

    def __init__(self, file: IO[str], candump: bool) -> None:
        self._file = file
        self._pushed: list[str] = []
        self._total_s = 0.0
        self._stamp = _CANDUMP if candump else _STAMP
        self._ahead = deque(itertools.islice(file, _AHEAD)) if candump else deque[str]()
        self._relative = candump and _are_differences(self._ahead)

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._pushed:
            return self._pushed.pop()
        line = self._ahead.popleft() if self._ahead else next(self._file)
        if _RELATIVE.match(line.strip()):
            self._relative = True
        elif self._relative and (stamp := self._stamp.match(line)):
            self._total_s += float(stamp[2])
            line = f"{stamp[1]}{self._total_s:.6f}{line[stamp.end() :]}"
        return line

    def push(self, line: str) -> None:
        """Give this line next."""
        self._pushed.append(line)

    def read(self, size: int = -1) -> str:
        """As a file has it; python-can knows files by it."""
        return self._file.read(size)

    def write(self, text: str) -> int:
        """As a file has it; python-can knows files by it."""
        return self._file.write(text)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _are_differences(lines: Iterable[str]) -> bool:
    """Whether the stamps of these lines are each since the one before: they go up and down, or stay."""
    stamps = [float(stamp[2]) for line in lines if (stamp := _CANDUMP.match(line))]
    if len(stamps) < 3 or max(stamps) > _SINCE_1970_S:
        return False
    back = sum(later < earlier for earlier, later in itertools.pairwise(stamps))
    same = sum(later == earlier for earlier, later in itertools.pairwise(stamps[1:]))
    return 10 * back > len(stamps) or (2 * same > len(stamps) and stamps[0] < stamps[-1] == max(stamps))
