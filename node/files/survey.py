"""Tables of where UEs were and when, for recordings that do not say so: CSV of ue, x, y, z and time.

    ue,x,y,z,time                          ue,x,y,z
    7,12.5,3.0,1.2,2026-03-01T10:00:00     7,12.5,3.0,1.2
    7,12.5,9.0,1.2,2026-03-01T10:00:05     8,2.5,3.0,1.2

Metres in world axes; time is ISO 8601 (UTC unless it says otherwise) or seconds since 1970, as in the frames.
Without it a UE has one place for good; with it, it goes straight and evenly from one row to the next, and is
nowhere before the first and after the last.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_NEEDED, _KNOWN = {"ue", "x", "y", "z"}, {"ue", "x", "y", "z", "time"}
MOST_ROWS = 10_000_000


class Survey:
    """Where UEs were: of each, times in ns (R,), or None where it stands, and places (R, 3)."""

    def __init__(self, ways: Mapping[int, tuple[NDArray[np.int64] | None, Floats]]) -> None:
        self._ways = dict(ways)

    @property
    def ues(self) -> list[int]:
        """Whose places are known."""
        return sorted(self._ways)

    def at(self, ue: NDArray[np.uint64], time_ns: NDArray[np.int64]) -> Floats:
        """Places (K, 3), NaN where unknown."""
        found = np.full((len(ue), 3), np.nan)
        for one in np.unique(ue):
            way = self._ways.get(int(one))
            if way is None:
                continue
            mine = np.flatnonzero(ue == one)
            times, places = way
            if times is None:
                found[mine] = places[0]
                continue
            since = (time_ns[mine] - times[0]).astype(np.float64)
            rows = (times - times[0]).astype(np.float64)
            there = (since >= 0) & (since <= rows[-1])
            for axis in range(3):
                found[mine[there], axis] = np.interp(since[there], rows, places[:, axis])
        return found


def read_survey(path: Path) -> Survey:
    """The table in a file.

    Raises
    ------
    ValueError
        If it cannot be read or is none; the message says which line, why, and what would be right.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(_rows(path, csv.reader(file, strict=True)))
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is no CSV table: {error}") from None
    ways: dict[int, tuple[NDArray[np.int64] | None, Floats]] = {}
    for ue in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == ue]
        places = np.array([row[1] for row in mine])
        times = [row[2] for row in mine if row[2] is not None]
        if len(mine) > 1 and not times:
            raise ValueError(f"{path}: UE {ue} has {len(mine)} places and no time that tells them apart")
        when = np.array(times, np.int64)
        order = np.argsort(when, kind="stable")
        ways[ue] = (when[order], places[order]) if times else (None, places)
    return Survey(ways)


def _rows(path: Path, lines: Iterator[list[str]]) -> Iterator[tuple[int, tuple[float, ...], int | None]]:
    """UE, place and time of each line."""
    names = [name.strip().lower() for name in next(lines, [])]
    if not set(names) >= _NEEDED or not set(names) <= _KNOWN or len(set(names)) < len(names):
        raise ValueError(f"{path}: the first line must be ue,x,y,z or ue,x,y,z,time, not {','.join(names)}")
    for number, line in enumerate(lines, 2):
        if not any(word.strip() for word in line):
            continue
        if number > MOST_ROWS:
            raise ValueError(f"{path} has more than {MOST_ROWS} lines")
        if len(line) != len(names):
            raise ValueError(f"{path}, line {number}: {len(line)} values for {len(names)} columns")
        words = dict(zip(names, (word.strip() for word in line), strict=True))
        try:
            yield _ue(words["ue"]), _place(words), _time_ns(words["time"]) if "time" in words else None
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from None


def _ue(word: str) -> int:
    if not (word.isascii() and word.isdecimal()) or int(word) >= 1 << 64:
        raise ValueError(f"{word!r} is no UE id (0 to 2^64 - 1)")
    return int(word)


def _place(words: Mapping[str, str]) -> tuple[float, ...]:
    found = []
    for name in "xyz":
        try:
            found.append(float(words[name]))
        except ValueError:
            raise ValueError(f"{name} = {words[name]!r} is no number of metres") from None
    if not all(map(math.isfinite, found)):
        raise ValueError(f"x, y and z must be finite, not {found}")
    return tuple(found)


def _time_ns(word: str) -> int:
    """Nanoseconds since the epoch."""
    try:
        seconds = float(word)
    except ValueError:
        try:
            moment = datetime.fromisoformat(word)
        except ValueError:
            raise ValueError(f"time {word!r} is neither ISO 8601 nor seconds since 1970") from None
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
        seconds = moment.timestamp()
    if not abs(seconds) < 9e9:
        raise ValueError(f"time {word!r} is no time that a frame can have")
    return round(seconds * 1e9)
