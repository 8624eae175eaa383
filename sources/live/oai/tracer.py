"""The stream of OpenAirInterface's T tracer: message descriptions, then events that they describe.

An event is `i32 length` of what follows, `i64 seconds, i64 nanoseconds, i32 type`, and its arguments. Types
-1 (a chunk of the descriptions' text) and -2 (their end) come first, whatever the version of the gNB.
Little-endian, as on the machines that run one.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from chachart.sources.live.device import CodecError

LONGEST_EVENT = 1 << 20
"""Above the tracer's own limit of 64 KiB by far."""
LONGEST_TEXT = 16 << 20
MOST_MESSAGES = 65536

CHUNK, END = -1, -2
Kind = Literal["int", "ulong", "float", "string", "buffer"]
Value = int | float | bytes

_LENGTH = struct.Struct("<i")
_HEAD = struct.Struct("<qqi")
_SIZED: dict[str, struct.Struct] = {
    "int": struct.Struct("<i"),
    "ulong": struct.Struct("<Q"),
    "float": struct.Struct("<f"),
}


@dataclass(frozen=True, slots=True)
class Description:
    """One kind of event: its name, and kind and name of each argument."""

    name: str
    arguments: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Event:
    """One event: when (nanoseconds since the Unix epoch), which type, its arguments as they came."""

    time_ns: int
    type: int
    body: bytes


class EventStream:
    """Bytes in, events out.

    Raises
    ------
    CodecError
        `length` if an event cannot be so long: the stream is lost.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> Iterator[Event]:
        """The events that `data` completes."""
        self._waiting += data
        at = 0
        try:
            while at + _LENGTH.size <= len(self._waiting):
                (length,) = _LENGTH.unpack_from(self._waiting, at)
                if not _HEAD.size <= length <= LONGEST_EVENT:
                    raise CodecError(
                        "length", f"an event of {length} bytes: this is no T tracer, or it lost its way"
                    )
                if at + _LENGTH.size + length > len(self._waiting):
                    break
                seconds, nanoseconds, kind = _HEAD.unpack_from(self._waiting, at + _LENGTH.size)
                begin = at + _LENGTH.size + _HEAD.size
                at += _LENGTH.size + length
                yield Event(seconds * 1_000_000_000 + nanoseconds, kind, bytes(self._waiting[begin:at]))
        finally:
            del self._waiting[:at]


def encode_event(event: Event) -> bytes:
    """An event as the gNB sends it."""
    head = _HEAD.pack(*divmod(event.time_ns, 1_000_000_000), event.type)
    return _LENGTH.pack(len(head) + len(event.body)) + head + event.body


def chunk_text(body: bytes) -> bytes:
    """The text in an event of type `CHUNK`.

    Raises
    ------
    CodecError
        `chunk` if it says that there is more than there is.
    """
    if (
        len(body) < _LENGTH.size
        or not 0 <= (size := _LENGTH.unpack_from(body)[0]) <= len(body) - _LENGTH.size
    ):
        raise CodecError("chunk", "a chunk of the descriptions says another length than it has")
    return body[_LENGTH.size : _LENGTH.size + size]


def parse_descriptions(text: str) -> list[Description]:
    """T_messages.txt: `ID = NAME` and `FORMAT = kind,name : kind,name`; ids count from 0 in that order.

    Raises
    ------
    CodecError
        `descriptions` if an argument is of no known kind, or there are unreasonably many.
    """
    found: list[Description] = []
    for line in text.splitlines():
        key, equals, value = (part.strip() for part in line.partition("="))
        if key == "ID" and equals:
            found.append(Description(value, ()))
        elif key == "FORMAT" and equals and found:
            found[-1] = Description(
                found[-1].name, tuple(_argument(part) for part in re.split(r"\s*:\s*", value) if part)
            )
    if len(found) > MOST_MESSAGES:
        raise CodecError("descriptions", f"{len(found)} kinds of events")
    return found


def _argument(part: str) -> tuple[str, str]:
    kind, comma, name = (word.strip() for word in part.partition(","))
    if kind not in (*_SIZED, "string", "buffer") or not comma:
        raise CodecError("descriptions", f"an argument {part!r}: no kind that is known")
    return kind, name


def decode_arguments(description: Description, body: bytes) -> dict[str, Value]:
    """The arguments of an event by name.

    Raises
    ------
    CodecError
        `arguments` if they are not what the description says.
    """
    values: dict[str, Value] = {}
    at = 0
    try:
        for kind, name in description.arguments:
            if kind == "string":
                end = body.index(b"\0", at)
                values[name], at = body[at:end], end + 1
            elif kind == "buffer":
                (size,) = _LENGTH.unpack_from(body, at)
                at += _LENGTH.size
                if not 0 <= size <= len(body) - at:
                    raise CodecError("arguments", f"{name} says {size} bytes, {len(body) - at} are left")
                values[name], at = body[at : at + size], at + size
            else:
                (values[name],) = _SIZED[kind].unpack_from(body, at)
                at += _SIZED[kind].size
    except (struct.error, ValueError) as error:
        if isinstance(error, CodecError):
            raise
        raise CodecError("arguments", f"{description.name} is shorter than its description") from None
    return values


def encode_arguments(description: Description, values: dict[str, Value]) -> bytes:
    """The arguments of an event, as the gNB sends them."""
    parts = []
    for kind, name in description.arguments:
        value = values[name]
        if isinstance(value, bytes):
            parts.append(value + b"\0" if kind == "string" else _LENGTH.pack(len(value)) + value)
        else:
            parts.append(_SIZED[kind].pack(value))
    return b"".join(parts)


def subscription(wanted: set[int], count: int) -> bytes:
    """What a client sends to have the events `wanted` switched on and all others off."""
    return b"\x01" + struct.pack(f"<i{count}i", count, *(int(i in wanted) for i in range(count)))
