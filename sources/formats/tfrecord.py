"""TFRecord files of `tf.train.Example` records, as the DICHASUS data sets use them, without TensorFlow.

A record is its length (8 bytes), the masked CRC-32C of that, the data, and their masked CRC-32C. Each
feature of the records is a variable with one row a record: DICHASUS files have `csi` of (records, antennas,
subcarriers, 2), to be read with --axes ue,antenna,subcarrier,iq, and `pos-tachy`.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.extras import missing, require
from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.tfexample import read_example

NAME = "TFRecord"

_HEAD = struct.Struct("<QI")
_CRC_BYTES = 4


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < _HEAD.size:
        return "it is too short for a record"
    if lacking := missing("formats"):
        return lacking[0]
    _, crc = _HEAD.unpack_from(head)
    return None if masked_crc(head[:8]) == crc else "its first record's length has another checksum"


def open_capture(path: Path) -> Capture:
    """The features of the records.

    Raises
    ------
    SetupError
        If google-crc32c is not installed, or the file is damaged or cut short.
    """
    require("formats", "TFRecord files:")
    return TfrecordCapture(path)


def masked_crc(data: bytes) -> int:
    """The CRC-32C of some bytes, masked as TFRecord files have it."""
    import google_crc32c

    crc = int(google_crc32c.value(data))
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


class TfrecordCapture(Capture):
    """An opened TFRecord file."""

    format = NAME

    def __init__(self, path: Path) -> None:
        super().__init__(path, {})
        try:
            with path.open("rb") as file:
                self._records, cut = _records(file, path.stat().st_size)
                first = self._features(file, 0)
        except (ValueError, OSError) as error:
            raise self.damaged(error) from None
        count = len(self._records)
        if cut:
            self.left_out["cut short"] = 1
        self.variables = {name: Variable((count, *v.shape), str(v.dtype)) for name, v in first.items()}

    def _read(self, name: str) -> NDArray[Any]:
        try:
            with self.path.open("rb") as file:
                return self._column(file, name)
        except (ValueError, OSError) as error:
            raise self.damaged(error) from None

    def _column(self, file: BinaryIO, name: str) -> NDArray[Any]:
        rows: NDArray[Any] | None = None
        for n in range(len(self._records)):
            value = self._features(file, n).get(name)
            if rows is None and value is not None:
                rows = np.empty((len(self._records), *value.shape), value.dtype)
            if rows is None or value is None or value.shape != rows.shape[1:] or value.dtype != rows.dtype:
                what = "no" if value is None else f"{value.dtype} {value.shape} as"
                raise ValueError(f'record {n} has {what} "{name}", unlike the first')
            rows[n] = value
        assert rows is not None
        return rows

    def _features(self, file: BinaryIO, n: int) -> dict[str, NDArray[Any]]:
        offset, length = self._records[n]
        file.seek(offset)
        data = file.read(length)
        if masked_crc(data) != int.from_bytes(file.read(_CRC_BYTES), "little"):
            raise ValueError(f"record {n} has another checksum")
        try:
            return read_example(memoryview(data))
        except (ValueError, struct.error) as error:
            raise ValueError(f"record {n} is no tf.train.Example: {error}") from None


def _records(file: BinaryIO, size: int) -> tuple[list[tuple[int, int]], bool]:
    """Offset and length of the data of each record that is whole, and whether the last one is cut short."""
    found: list[tuple[int, int]] = []
    offset = 0
    while offset < size:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        length, crc = _HEAD.unpack(head)
        if masked_crc(head[:8]) != crc:
            raise ValueError(f"the length of record {len(found)} has another checksum")
        data = offset + _HEAD.size
        offset = data + length + _CRC_BYTES
        if offset > size:
            break
        found.append((data, length))
    if not found:
        raise ValueError("it ends within record 0")
    return found, offset != size
