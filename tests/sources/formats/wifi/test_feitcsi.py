from __future__ import annotations

import numpy as np
import pytest
from wifi_captures import feitcsi, integers

from chachart.sources.formats.wifi.feitcsi import read
from chachart.sources.formats.wifi.log import Log

HT20, HT40, VHT80, VHT160, HE160 = (
    2 << 8,
    2 << 8 | 1 << 11,
    3 << 8 | 2 << 11,
    3 << 8 | 3 << 11,
    4 << 8 | 3 << 11,
)


def log_of(data: bytes) -> Log:
    return read(np.frombuffer(data, np.uint8))


@pytest.mark.parametrize(
    ("rate", "tones", "first"), [(HT20, 56, -28), (HT40, 114, -58), (VHT80, 242, -122), (HE160, 1992, -1012)]
)
def test_values_and_subcarriers(rate: int, tones: int, first: int) -> None:
    csi = integers(3, tones, 2, 2, limit=30_000)
    [group] = log_of(feitcsi(csi, rate)).groups
    np.testing.assert_array_equal(group.csi, csi.transpose(0, 2, 3, 1))
    assert group.kind.tones.numbers is not None
    assert (group.kind.tones.numbers[0], len(group.kind.tones.numbers)) == (first, tones)
    assert group.kind.tones.weak, "pilots"
    assert (group.columns["ue"] == 0x0200_0000_0003).all()
    np.testing.assert_array_equal(group.columns["rssi"][0], [-41, -39])
    np.testing.assert_array_equal(np.diff(group.columns["time"]), 1_500_000)


@pytest.mark.parametrize(
    ("rate", "tones", "unused"), [(HE160, 2020, slice(996, 1024)), (VHT160, 498, slice(242, 256))]
)
def test_unused_subcarriers_at_160_mhz_are_left_out(rate: int, tones: int, unused: slice) -> None:
    csi = integers(2, tones, 2, 1, limit=30_000)
    [group] = log_of(feitcsi(csi, rate)).groups
    np.testing.assert_array_equal(group.csi, np.delete(csi, unused, axis=1).transpose(0, 2, 3, 1))
    assert group.kind.tones.numbers is not None


def test_kinds_and_what_is_not_whole() -> None:
    narrow, wide = integers(4, 56, 2, 1), integers(2, 114, 2, 1)
    log = log_of((feitcsi(narrow) + feitcsi(wide, HT40))[:-7])
    assert [len(group) for group in log.groups] == [4, 1]
    assert log.groups[1].kind.differs_in(log.groups[0].kind, log.order) == "other shape"
    assert dict(log.left_out) == {"cut short": 1}
    data = bytearray(feitcsi(narrow))
    one = len(data) // 4
    data[one : one + 4] = b"\xff\xff\xff\xff"
    log = log_of(bytes(data))
    np.testing.assert_array_equal(log.groups[0].csi, narrow[[0, 2, 3]].transpose(0, 2, 3, 1))
    assert dict(log.left_out) == {"broken record": 1}
