"""Frames of an ESPARGOS controller on a serial line: COBS, inside it a header of eight bytes.

Zero bytes end the frames. `u8 version = 1, u8 type, u16 request id, u32 length`, then so many bytes. All
little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from chachart.sources.live.device import CodecError

VERSION = 1
LONGEST_PAYLOAD = 1 << 16
_HEADER = struct.Struct("<BBHI")
_REQUEST = struct.Struct("<BHI")
_RESPONSE = struct.Struct("<HHI")
_HELLO = struct.Struct("<HHHH")


class Kind(IntEnum):
    """What a frame is."""

    HELLO = 0x01
    HELLO_RESPONSE = 0x02
    REQUEST = 0x10
    RESPONSE = 0x11
    SENSOR_PACKET = 0x20
    STREAM_CONTROL = 0x21
    LOG = 0x30


SENSOR_DATA, KEEP_ALIVE = 1, 0
"""Streams that `STREAM_CONTROL` names."""


@dataclass(frozen=True, slots=True)
class UartFrame:
    """One frame; `number` pairs a response with its request."""

    kind: int
    number: int
    payload: bytes


def encode(frame: UartFrame) -> bytes:
    """The bytes before COBS."""
    return _HEADER.pack(VERSION, frame.kind, frame.number, len(frame.payload)) + frame.payload


def decode(data: bytes) -> UartFrame:
    """The frame in the bytes behind COBS.

    Raises
    ------
    CodecError
        `uart` if it is none.
    """
    if len(data) < _HEADER.size:
        raise CodecError("uart", f"a frame has at least {_HEADER.size} bytes")
    version, kind, number, length = _HEADER.unpack_from(data)
    if version != VERSION or length != len(data) - _HEADER.size:
        raise CodecError(
            "uart", f"version {version}, {length} bytes said and {len(data) - _HEADER.size} there"
        )
    return UartFrame(kind, number, data[_HEADER.size :])


def hello_response(device: str, revision: str, major: int, minor: int) -> bytes:
    """What a controller answers to a hello."""
    return _HELLO.pack(len(device), len(revision), major, minor) + device.encode() + revision.encode()


def parse_hello(payload: bytes) -> tuple[str, int]:
    """Device and major version of the interface that a controller says it has.

    Raises
    ------
    CodecError
        `uart` if the payload is cut.
    """
    if len(payload) < _HELLO.size:
        raise CodecError("uart", "a hello is cut")
    device, _, major, _ = _HELLO.unpack_from(payload)
    return payload[_HELLO.size : _HELLO.size + device].decode("utf-8", "replace"), major


def request(method: str, path: str, body: bytes) -> bytes:
    """A request as HTTP would have it."""
    return _REQUEST.pack(method == "POST", len(path), len(body)) + path.encode() + body


def parse_request(payload: bytes) -> tuple[str, bytes]:
    """Path and body of a request.

    Raises
    ------
    CodecError
        `uart` if the payload is cut.
    """
    _, path, body = _parts(_REQUEST, payload, "a request")
    return path.decode("utf-8", "replace"), body


def response(status: int, body: bytes, kind: str = "text/plain") -> bytes:
    """An answer as HTTP would have it."""
    return _RESPONSE.pack(status, len(kind), len(body)) + kind.encode() + body


def parse_response(payload: bytes) -> tuple[int, str]:
    """Status and text of an answer.

    Raises
    ------
    CodecError
        `uart` if the payload is cut.
    """
    status, _, body = _parts(_RESPONSE, payload, "an answer")
    return status, body.decode("utf-8", "replace")


def _parts(head: struct.Struct, payload: bytes, what: str) -> tuple[int, bytes, bytes]:
    """The head's first number, and the two strings behind it whose lengths follow in the head."""
    if len(payload) >= head.size:
        number, first, second = head.unpack_from(payload)
        rest = payload[head.size :]
        if len(rest) == first + second:
            return number, rest[:first], rest[first:]
    raise CodecError("uart", f"{what} is cut")
