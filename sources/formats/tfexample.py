"""`tf.train.Example` messages: a map from names to lists of bytes, floats or integers, as a protocol buffer.

Bytes that hold a tensor, as `tf.io.serialize_tensor` writes it, become that tensor. Only what such messages
use of protocol buffers is here; sizes are checked against the bytes there are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TENSOR_TYPES = {
    1: "<f4",
    2: "<f8",
    3: "<i4",
    4: "u1",
    5: "<i2",
    6: "i1",
    8: "<c8",
    9: "<i8",
    17: "<u2",
    18: "<c16",
    19: "<f2",
    22: "<u4",
    23: "<u8",
}
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LONGEST_VARINT = 10

Fields = Iterator[tuple[int, int, Any]]


def read_example(data: memoryview) -> dict[str, NDArray[Any]]:
    """The features of a message by name; one value alone has no axis.

    Raises
    ------
    ValueError
        If it is no such message.
    """
    features = {}
    for group in _only(data, 1):
        for entry in _only(group, 1):
            key = next(_only(entry, 1), memoryview(b""))
            for feature in _only(entry, 2):
                for kind, wire, values in _fields(feature):
                    if wire == _BYTES:
                        features[bytes(key).decode("utf-8")] = _feature(kind, values)
    return features


def _fields(data: memoryview) -> Fields:
    """Number, wire type and value of each field of a protocol buffer message."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
            yield number, wire, value
            continue
        if wire == _BYTES:
            length, at = _varint(data, at)
        elif wire in (_FIXED64, _FIXED32):
            length = 8 if wire == _FIXED64 else 4
        else:
            raise ValueError(f"wire type {wire} at byte {at}")
        if at + length > len(data):
            raise ValueError(f"a field of {length} bytes at byte {at} of {len(data)}")
        yield number, wire, data[at : at + length]
        at += length


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for n in range(_LONGEST_VARINT):
        if at + n >= len(data):
            break
        byte = data[at + n]
        value |= (byte & 0x7F) << (7 * n)
        if byte < 0x80:
            return value, at + n + 1
    raise ValueError(f"a broken number at byte {at}")


def _only(data: memoryview, number: int) -> Iterator[memoryview]:
    for found, wire, value in _fields(data):
        if found == number and wire == _BYTES:
            yield value


def _feature(kind: int, values: memoryview) -> NDArray[Any]:
    """A feature's list: kind 1 bytes, 2 floats, 3 integers."""
    items: list[Any] = []
    for number, wire, value in _fields(values):
        if number != 1:
            continue
        if kind == 1 and wire == _BYTES:
            items.append(_tensor(value))
        elif kind == 2 and wire in (_BYTES, _FIXED32):
            items += np.frombuffer(value, "<f4").tolist()
        elif kind == 3 and wire == _VARINT:
            items.append(value)
        elif kind == 3 and wire == _BYTES:
            at = 0
            while at < len(value):
                item, at = _varint(value, at)
                items.append(item)
    if kind == 1:
        return items[0] if len(items) == 1 else np.asarray([str(item) for item in items])
    column = np.array(items, np.float32 if kind == 2 else np.uint64)
    column = column.view(np.int64) if kind == 3 else column
    return column.reshape(()) if len(column) == 1 else column


def _tensor(data: memoryview) -> NDArray[Any]:
    """The tensor that bytes hold; bytes that hold none as they are."""
    dtype, shape, content = 0, [], memoryview(b"")
    try:
        for number, wire, value in _fields(data):
            if number == 1 and wire == _VARINT:
                dtype = value
            elif number == 2 and wire == _BYTES:
                shape = [
                    next((size for n, w, size in _fields(d) if n == 1 and w == _VARINT), 0)
                    for d in _only(value, 2)
                ]
            elif number == 4 and wire == _BYTES:
                content = value
    except ValueError:
        dtype = 0
    kind = np.dtype(_TENSOR_TYPES.get(dtype, "V1"))
    if kind.kind == "V" or math.prod(shape) * kind.itemsize != len(content):
        return np.asarray(bytes(data))
    return np.frombuffer(content, kind).reshape(shape)
