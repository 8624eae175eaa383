"""TFRecord files of `tf.train.Example` records, as the DICHASUS data sets use them, without TensorFlow.

A record is its length (8 bytes), the masked CRC-32C of that, the data, and their masked CRC-32C. Each
feature of the records is a variable with one row a record: DICHASUS files have `csi` of (records, antennas,
subcarriers, 2), to be read with --axes ue,antenna,subcarrier,iq, and `pos-tachy`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.base import Capture, Variable
from chachart.sources.formats.crc32c import crc32c, masked
from chachart.sources.formats.tfexample import read_example

NAME = "TFRecord"

_HEAD = struct.Struct("<QI")
_CRC_BYTES = 4


def why_not(head: bytes) -> str | None:
    """Why a file that begins with `head` is not of this format; None if it is."""
    if len(head) < _HEAD.size:
        return "it is too short for a record"
    _, crc = _HEAD.unpack_from(head)
    return None if masked(crc32c(head[:8])) == crc else "its first record's length has another checksum"


def open_capture(path: Path) -> Capture:
    """The features of the records.

    Raises
    ------
    SetupError
        If the file is damaged or cut short.
    """
    return TfrecordCapture(path)


class TfrecordCapture(Capture):
    """An opened TFRecord file."""

    format = NAME

    def __init__(self, path: Path) -> None:
        super().__init__(path, {})
        try:
            with path.open("rb") as file:
                self._records = list(_records(file, path.stat().st_size))
                first = self._features(file, 0)
        except (ValueError, OSError) as error:
            raise self.damaged(error) from None
        count = len(self._records)
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
        data = memoryview(file.read(length + _CRC_BYTES))
        if masked(crc32c(data[:length])) != int.from_bytes(data[length:], "little"):
            raise ValueError(f"record {n} has another checksum")
        try:
            return read_example(data[:length])
        except (ValueError, struct.error) as error:
            raise ValueError(f"record {n} is no tf.train.Example: {error}") from None


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, int]]:
    """Offset and length of each record's data, which are checked against the size of the file."""
    offset = n = 0
    while offset < size:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise ValueError(f"it ends within record {n}")
        length, crc = _HEAD.unpack(head)
        if masked(crc32c(head[:8])) != crc:
            raise ValueError(f"the length of record {n} has another checksum")
        data = offset + _HEAD.size
        offset = data + length + _CRC_BYTES
        if offset > size:
            raise ValueError(f"it ends within record {n}")
        yield data, length
        n += 1
