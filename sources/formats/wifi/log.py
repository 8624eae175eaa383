"""What a Wi-Fi capture says: frames, grouped by what they must share to be one recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

SHAPE = ("antennas", "streams", "subcarriers")
REASONS = {
    "antenna_names": "other antennas",
    "bandwidth_hz": "other bandwidth",
    "carrier_hz": "other carrier",
    "channel": "other channel",
    "tones": "other subcarriers",
    "packet_format": "other packet format",
}
"""What a frame is left out for when it differs in this from those that are kept."""


class Tones(NamedTuple):
    """Numbers of subcarriers: f = carrier + number * spacing.

    Attributes
    ----------
    numbers
        One a value, ascending; None where the format does not say them.
    used
        Those that carry a signal by the standard: without guards and the middle.
    weak
        Those of them that do not count: overwritten by a firmware, or pilots too weak to be of use.
    spacing_hz
        Their distance; None where it is not known.
    """

    numbers: tuple[int, ...] | None
    used: tuple[int, ...] = ()
    weak: tuple[int, ...] = ()
    spacing_hz: float | None = 312_500.0


UNKNOWN = Tones(None)


@dataclass(frozen=True, slots=True)
class Kind:
    """What frames must share to be of one array and one set of subcarriers; None or empty: not told."""

    antennas: int
    streams: int
    subcarriers: int
    tones: Tones = UNKNOWN
    antenna_names: tuple[str, ...] = ()
    carrier_hz: float | None = None
    bandwidth_hz: float | None = None
    channel: int | None = None
    packet_format: str = ""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(antennas, streams, subcarriers)."""
        return self.antennas, self.streams, self.subcarriers

    def differs_in(self, other: Kind, order: tuple[str, ...]) -> str:
        """The reason for which frames of this kind are left out where `other` is kept.

        `order` says what is looked at first: "shape", or a field.
        """
        for name in (*order, *(f.name for f in fields(self) if f.name not in SHAPE)):
            if name == "shape" and self.shape != other.shape:
                return "other shape"
            if name != "shape" and getattr(self, name) != getattr(other, name):
                return REASONS[name]
        return "other shape"

    def __str__(self) -> str:
        said = [f"{self.antennas} antennas, {self.streams} streams, {self.subcarriers} subcarriers"]
        if self.antenna_names:
            said.append("antennas " + "+".join(self.antenna_names))
        if self.bandwidth_hz is not None:
            said.append(f"{self.bandwidth_hz / 1e6:g} MHz wide")
        if self.carrier_hz is not None:
            said.append(f"at {self.carrier_hz / 1e6:g} MHz")
        if self.tones.numbers:
            said.append(f"numbers {self.tones.numbers[0]} to {self.tones.numbers[-1]}")
        if self.packet_format:
            said.append(self.packet_format)
        return ", ".join(said)


@dataclass(slots=True)
class Group:
    """The frames of one kind, F of them.

    Attributes
    ----------
    kind
        What they share.
    number
        int (F,), numbers of the frames among those of the file.
    csi
        complex64 (F, antennas, streams, subcarriers), subcarriers ascending.
    columns
        One row a frame: `time` (int64, ns), `ue` (the sender's address as a number, 0 without one), and what
        else the format tells: `rssi_dbm`, `rssi`, `agc`, `noise`, ...
    more
        Other CSI of the same frames by name, with their subcarriers: the further training fields of ESP32.
    """

    kind: Kind
    number: NDArray[np.int64]
    csi: NDArray[np.complex64]
    columns: dict[str, NDArray[Any]]
    more: Mapping[str, tuple[Tones, NDArray[np.complex64]]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.number)


@dataclass(slots=True)
class Log:
    """What a capture holds.

    Attributes
    ----------
    groups
        The frames that are whole, by kind, in the order in which the kinds come.
    left_out
        How many are not whole, by reason: "cut short", "broken record", "incomplete", ...
    clock
        What their times are, in words; empty where there are none.
    has_senders
        Whether the file says who sent the frames.
    order
        What to compare kinds by; see `Kind.differs_in`.
    remarks
        Anything else that the user should be told.
    """

    groups: list[Group]
    left_out: Counter[str] = field(default_factory=Counter)
    clock: str = ""
    has_senders: bool = False
    order: tuple[str, ...] = ("shape", "antenna_names", "bandwidth_hz")
    remarks: list[str] = field(default_factory=list)

    @property
    def frames(self) -> int:
        """Frames in the file, whole or not; one that a cut has left no end does not count."""
        broken = sum(self.left_out.values()) - self.left_out["cut short"]
        return sum(map(len, self.groups)) + broken

    def commonest(self) -> Group:
        """The group with the most frames, of equal ones the first.

        Raises
        ------
        ValueError
            If there is none.
        """
        if not self.groups:
            told = ", ".join(f"{count} {reason}" for reason, count in sorted(self.left_out.items()))
            raise ValueError("it has no CSI frames" + (f" that are whole ({told})" if told else ""))
        return max(self.groups, key=len)


def gather(data: NDArray[np.uint8], starts: NDArray[np.int64], length: int) -> NDArray[np.uint8]:
    """`length` bytes from each of `starts`, as rows; all of them must be there."""
    if not len(starts):
        return np.empty((0, length), np.uint8)
    rows: NDArray[np.uint8] = np.lib.stride_tricks.sliding_window_view(data, length)[starts]
    return rows


def split(keys: NDArray[Any]) -> list[NDArray[np.int64]]:
    """Row numbers of equal rows of octets `keys` (F, n), an array a group, in order of their first rows."""
    if not len(keys):
        return []
    width = max(keys.shape[1], 8)
    packed = np.zeros((len(keys), width), np.uint8)
    packed[:, : keys.shape[1]] = keys
    if (packed == packed[0]).all():
        return [np.arange(len(packed), dtype=np.int64)]
    flat = packed.view(np.uint64 if width == 8 else np.dtype((np.void, width)))[:, 0]
    _, first, which = np.unique(flat, return_index=True, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(which.ravel()))[:-1])
    return [parts[n] for n in np.argsort(first)]


def merged(groups: list[Group]) -> list[Group]:
    """Groups of equal kind as one, frames in the order of the file; in the order of their first frames."""
    by_kind: dict[Kind, list[Group]] = {}
    for group in groups:
        by_kind.setdefault(group.kind, []).append(group)
    whole = [parts[0] if len(parts) == 1 else _joined(kind, parts) for kind, parts in by_kind.items()]
    return sorted(whole, key=lambda group: int(group.number[0]))


def _joined(kind: Kind, parts: list[Group]) -> Group:
    number = np.concatenate([part.number for part in parts])
    order = np.argsort(number, kind="stable")
    columns = {n: np.concatenate([p.columns[n] for p in parts])[order] for n in parts[0].columns}
    more = {
        name: (tones, np.concatenate([part.more[name][1] for part in parts])[order])
        for name, (tones, _) in parts[0].more.items()
    }
    return Group(kind, number[order], np.concatenate([part.csi for part in parts])[order], columns, more)


def address(octets: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """MAC addresses (F, 6) as numbers, the first octet highest."""
    wide = np.zeros((len(octets), 8), np.uint8)
    wide[:, 2:] = octets
    numbers: NDArray[np.uint64] = wide.view(">u8")[:, 0].astype(np.uint64)
    return numbers


def mac(ue: int) -> str:
    """A number as a MAC address.

    >>> mac(2199023255553)
    '02:00:00:00:00:01'
    """
    return ":".join(f"{octet:02x}" for octet in ue.to_bytes(6, "big"))
