"""Protocol 1: CSI blocks, charts, quality and status as bytes. Pure functions, no sockets.

Receivers check everything before they trust it: a message that does not fit raises `WireError` with a
short `reason` to count it by. Sizes are checked against what the bytes hold before anything is allocated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.csi import CsiBlock

VERSION = 1
MAX_HEADER_BYTES = 4 * 1024 * 1024
MAX_CSI_BYTES = 256 * 1024 * 1024
_UNPACK = {"csi": {"max_array_len": 64, "max_map_len": 64, "max_ext_len": 0}}
"""What strangers send: room for a list is made before its items come, once for each level of nesting."""
MAX_NAME = 128

Buffer = bytes | bytearray | memoryview


class WireError(ValueError):
    """A message that is not protocol 1. `reason` is a short word to count it by."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason


def encode_csi(block: CsiBlock) -> list[bytes | memoryview]:
    """The two parts `[header, csi]` of a block; the second is a view of the block's own memory."""
    return [msgpack.packb(_csi_header(block)), _csi_bytes(block)]


def encode_csi_map(block: CsiBlock) -> list[bytes | memoryview]:
    """A block as one self-contained msgpack map: the header of `encode_csi` and the samples as `csi`, last.

    In two parts that follow each other; the second is a view of the block's own memory.
    """
    header: bytes = msgpack.packb(_csi_header(block))
    csi = _csi_bytes(block)
    # A msgpack map of up to 15 entries begins with 0x80 + entries; 0xc6 is `bin` with 4 bytes of length.
    head = bytes([header[0] + 1]) + header[1:] + msgpack.packb("csi") + b"\xc6" + len(csi).to_bytes(4, "big")
    return [head, csi]


def decode_csi(parts: Sequence[Buffer]) -> CsiBlock:
    """The block that `[header, csi]` holds; complex64 samples are a read-only view of the second part.

    `"<i2"` samples (interleaved I, Q with a `scale`) become complex64.

    Raises
    ------
    WireError
        With reason `parts`, `header`, `version`, `type`, `field`, `shape`, `dtype`, `size` or `scale`.
    """
    return decode_csi_from(parts)[1]


def decode_csi_from(parts: Sequence[Buffer]) -> tuple[str | None, CsiBlock]:
    """The producer that a CSI message names, None if none, and its block.

    Raises
    ------
    WireError
        As `decode_csi`.
    """
    if len(parts) != 2:
        raise WireError("parts", f"a CSI message has 2 parts, not {len(parts)}")
    message = _unpack(parts[0], "csi")
    producer = message.get("producer")
    if producer is not None and not (isinstance(producer, str) and 0 < len(producer) <= MAX_NAME):
        raise WireError("field", f"producer must be text of 1 to {MAX_NAME} characters")
    return producer, _csi_block(message, parts[1])


def decode_csi_map(body: Buffer) -> CsiBlock:
    """The block that a map of `encode_csi_map` holds.

    Raises
    ------
    WireError
        As `decode_csi`.
    """
    message = _unpack(body, "csi", MAX_HEADER_BYTES + MAX_CSI_BYTES)
    return _csi_block(message, _field(message, "csi", bytes))


def chart_topic(array: str) -> bytes:
    """The topic under which charts of `array` are published."""
    return b"chart." + array.encode()


ROWS_AT_ONCE = 4096
"""So many rows are packed without letting other threads have the interpreter."""


def encode_chart(update: ChartUpdate, seq: int) -> bytes:
    """The msgpack body of a chart message; plain lists, so that any language reads it."""
    body = chart_body(update, seq)
    if len(update) <= ROWS_AT_ONCE:
        columns = {name: values.tolist() for name, values in update.columns.items()}
        return bytes(msgpack.packb({**body, **columns}))
    packer = msgpack.Packer()
    pieces = [packer.pack_map_header(len(body) + len(update.columns))]
    for name, value in body.items():
        pieces += [packer.pack(name), packer.pack(value)]
    for name, values in update.columns.items():
        pieces += [packer.pack(name), packer.pack_array_header(len(values))]
        for start in range(0, len(values), ROWS_AT_ONCE):
            part = values[start : start + ROWS_AT_ONCE]
            header = len(packer.pack_array_header(len(part)))
            pieces.append(packer.pack(part.tolist())[header:])
    return b"".join(pieces)


def chart_body(update: ChartUpdate, seq: int) -> dict[str, Any]:
    """What a chart message says beside its columns."""
    method = {"theta": update.method.theta, "rho": update.method.rho}
    return {"v": VERSION, "type": "chart", "array": update.array, "seq": seq, "method": method}


def decode_chart(body: Buffer) -> tuple[int, ChartUpdate]:
    """The sequence number and the update that a chart message holds; columns nobody here knows are left out.

    Raises
    ------
    WireError
        With reason `header`, `version`, `type` or `field`.
    """
    message = _unpack(body, "chart")
    method = _field(message, "method", dict)
    rows = len(_field(message, "ue", list))
    columns = {}
    for column in COLUMNS.values():
        if not column.optional or column.name in message:
            values = _field(message, column.name, list)
            columns[column.name] = _numbers(column.name, values, column.dtype, column.shape(rows))
    update = ChartUpdate(
        _field(message, "array", str),
        Method(_field(method, "theta", str), _field(method, "rho", str)),
        **columns,
    )
    return _field(message, "seq", int), update


def encode_report(kind: str, array: str, seq: int, time_ns: int, values: Mapping[str, Any]) -> bytes:
    """The msgpack body of a `quality` or `status` message: `values` beside the usual header fields."""
    body = {"v": VERSION, "type": kind, "array": array, "seq": seq, "time_ns": time_ns, **values}
    return bytes(msgpack.packb(body))


def decode_report(kind: str, body: Buffer) -> dict[str, Any]:
    """The map that a `quality` or `status` message holds.

    Raises
    ------
    WireError
        With reason `header`, `version` or `type`.
    """
    return _unpack(body, kind)


def _csi_header(block: CsiBlock) -> dict[str, Any]:
    header: dict[str, Any] = {
        "v": VERSION,
        "type": "csi",
        "array": block.array,
        "seq": block.seq,
        "shape": list(block.csi.shape),
        "dtype": "<c8",
        "ue": _raw(block.ue, "<u8"),
        "time_ns": _raw(block.time_ns, "<i8"),
    }
    if block.position is not None:
        header["position"] = _raw(block.position, "<f4")
    if block.packet is not None:
        header["packet"] = _raw(block.packet, "<u8")
    return header


def _csi_bytes(block: CsiBlock) -> memoryview:
    return np.ascontiguousarray(block.csi, "<c8").data.cast("B")


def _csi_block(header: Mapping[str, Any], raw: Buffer) -> CsiBlock:
    array = _field(header, "array", str)
    if not 0 < len(array) <= MAX_NAME:
        raise WireError("field", f"array must have 1 to {MAX_NAME} characters, not {len(array)}")
    seq = _field(header, "seq", int)
    if not 0 <= seq < 2**63:
        raise WireError("field", f"seq must be at least 0 and below 2**63, not {seq}")
    shape = _field(header, "shape", list)
    if len(shape) != 3 or not all(type(n) is int and n > 0 for n in shape):
        raise WireError(
            "shape", f"shape must be [frames, antennas, subcarriers], all positive, not {shape}"[:200]
        )
    frames = shape[0]
    csi = _samples(header, raw, shape)
    position = None
    if "position" in header:
        position = _column(header, "position", "<f4", frames * 3).reshape(frames, 3)
    packet = _column(header, "packet", "<u8", frames) if "packet" in header else None
    return CsiBlock(
        array,
        seq,
        _column(header, "ue", "<u8", frames),
        _column(header, "time_ns", "<i8", frames),
        csi,
        position,
        packet,
    )


def _raw(values: NDArray[Any], dtype: str) -> bytes:
    return np.ascontiguousarray(values, dtype).tobytes()


def _unpack(body: Buffer, kind: str, limit: int = MAX_HEADER_BYTES) -> dict[str, Any]:
    if memoryview(body).nbytes > limit:
        raise WireError("size", f"{memoryview(body).nbytes} bytes of msgpack, at most {limit} are read")
    try:
        message = msgpack.unpackb(body, **_UNPACK.get(kind, {}))
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise WireError("header", f"not msgpack: {error}") from None
    if not isinstance(message, dict):
        raise WireError("header", f"a map is expected, not {type(message).__name__}")
    if message.get("v") != VERSION:
        raise WireError("version", f"v must be {VERSION}, not {message.get('v')!r}"[:200])
    if message.get("type") != kind:
        raise WireError("type", f"type must be {kind!r}, not {message.get('type')!r}"[:200])
    return message


def _field(message: Mapping[str, Any], name: str, kind: type) -> Any:
    value = message.get(name)
    if type(value) is not kind:
        raise WireError("field", f"{name} must be {kind.__name__}, not {type(value).__name__}")
    return value


def _column(header: Mapping[str, Any], name: str, dtype: str, n: int) -> NDArray[Any]:
    raw = _field(header, name, bytes)
    if len(raw) != n * np.dtype(dtype).itemsize:
        raise WireError("size", f"{name} must hold {n} values of {dtype}, not {len(raw)} bytes")
    native = np.dtype(dtype).newbyteorder("=")
    return np.frombuffer(raw, dtype).astype(native, copy=False)


def _samples(header: Mapping[str, Any], raw: Buffer, shape: list[int]) -> NDArray[np.complex64]:
    dtype = header.get("dtype")
    if dtype not in ("<c8", "<i2"):
        raise WireError("dtype", f"dtype must be '<c8' or '<i2', not {dtype!r}"[:200])
    size = memoryview(raw).nbytes
    expected = math.prod(shape) * (8 if dtype == "<c8" else 4)
    if size != expected or size > MAX_CSI_BYTES:
        raise WireError(
            "size",
            f"shape {shape} of {dtype} takes {expected} bytes (at most {MAX_CSI_BYTES}), not {size}"[:200],
        )
    if dtype == "<c8":
        samples = np.frombuffer(raw, "<c8").reshape(shape).astype(np.complex64, copy=False)
        # Short ZeroMQ messages may lie anywhere in memory; numpy is slow on samples that are not aligned.
        return np.require(samples, requirements="A")
    scale = header.get("scale")
    if not isinstance(scale, int | float) or isinstance(scale, bool) or not 1e-30 <= scale <= 1e30:
        raise WireError("scale", f"scale must be a number from 1e-30 to 1e30, not {scale!r}"[:200])
    pairs = np.frombuffer(raw, "<i2").astype(np.float32) * np.float32(scale)
    return pairs.view(np.complex64).reshape(shape)


def _numbers(name: str, values: list[Any], dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    try:
        column: NDArray[Any] = np.array(values, dtype).reshape(shape)
    except (ValueError, TypeError, OverflowError) as error:
        raise WireError("field", f"{name} does not hold {shape} numbers: {error}"[:200]) from None
    return column
