"""Whatever bytes a reader gets, it gives frames or says in one line why not; what it gives fits together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from picoscenes_captures import picoscenes
from wifi_captures import atheros, esp32, feitcsi, integers, intel5300, nexmon, nexmon_packets, pcapng

from chachart.sources.formats.wifi import atheros as atheros_format
from chachart.sources.formats.wifi import esp32 as esp32_format
from chachart.sources.formats.wifi import feitcsi as feitcsi_format
from chachart.sources.formats.wifi import intel5300 as intel5300_format
from chachart.sources.formats.wifi import nexmon as nexmon_format
from chachart.sources.formats.wifi import picoscenes as picoscenes_format
from chachart.sources.formats.wifi.capture import Read
from chachart.sources.formats.wifi.log import Log

INTEL = integers(5, 30, 3, 2)
WRITTEN: dict[str, tuple[Read, bytes]] = {
    "intel5300": (intel5300_format.read, intel5300(INTEL, senders=[1, 2, 1, 2, 1])),
    "intel5300 fork": (intel5300_format.read, intel5300(INTEL, fork=True)),
    "atheros": (atheros_format.read, atheros(integers(5, 56, 3, 2, limit=500))),
    "atheros flag": (atheros_format.read, b"\xff" + atheros(integers(5, 56, 2, 1, limit=500), ">")),
    "nexmon": (nexmon_format.read, nexmon(integers(6, 2, 64, limit=2000))),
    "nexmon pcapng": (nexmon_format.read, pcapng(nexmon_packets(integers(6, 2, 64, limit=2000)))),
    "esp32": (esp32_format.read, esp32(integers(4, 64))),
    "feitcsi": (feitcsi_format.read, feitcsi(integers(4, 56, 2, 1, limit=30_000))),
    "picoscenes ax210": (picoscenes_format.read, picoscenes(integers(4, 56, 2, 1, limit=30_000))),
    "picoscenes 5300": (picoscenes_format.read, picoscenes(integers(4, 30, 3, 1), "5300")),
    "picoscenes 9300": (picoscenes_format.read, picoscenes(integers(4, 56, 2, 2, limit=500), "9300")),
    "picoscenes usrp": (picoscenes_format.read, picoscenes(integers(4, 52, 1, 1) / 8, "usrp")),
}


def assert_fits_together(log: Log, size: int) -> None:
    """That frames, numbers and columns have the shapes they should, and are not more than the bytes hold."""
    numbers = [int(n) for group in log.groups for n in group.number]
    assert len(set(numbers)) == len(numbers)
    assert max(numbers, default=-1) < max(log.frames, 1)
    assert sum(group.csi.nbytes for group in log.groups) <= 16 * size
    for group in log.groups:
        assert group.csi.shape == (len(group), *group.kind.shape)
        assert all(len(values) == len(group) for values in group.columns.values())
        assert group.columns["time"].dtype == np.int64
        assert group.columns["ue"].dtype == np.uint64
        tones = group.kind.tones.numbers
        assert tones is None or (len(tones) == group.kind.subcarriers and list(tones) == sorted(set(tones)))


@pytest.mark.parametrize("name", WRITTEN)
@given(data=st.data())
def test_damaged_captures(name: str, data: st.DataObject) -> None:
    read, whole = WRITTEN[name]
    damaged = bytearray(whole)
    if data.draw(st.booleans(), "cut"):
        del damaged[data.draw(st.integers(0, len(damaged)), "length") :]
    for _ in range(data.draw(st.integers(0, 4), "flips") if damaged else 0):
        at = data.draw(st.integers(0, min(len(damaged), 200) - 1) | st.integers(0, len(damaged) - 1), "at")
        damaged[at] ^= data.draw(st.integers(1, 255), "by")
    try:
        log = read(np.frombuffer(bytes(damaged), np.uint8))
    except (ValueError, KeyError) as error:
        event(str(error))
        return
    event(", ".join(log.left_out) or "whole")
    assert_fits_together(log, len(damaged))


@pytest.mark.parametrize("name", WRITTEN)
@given(junk=st.binary(max_size=400), at=st.floats(0, 1))
def test_junk_between_records_costs_few(name: str, junk: bytes, at: float) -> None:
    read, whole = WRITTEN[name]
    place = round(at * len(whole))
    try:
        log = read(np.frombuffer(whole[:place] + junk + whole[place:], np.uint8))
    except (ValueError, KeyError):
        return
    assert_fits_together(log, len(whole) + len(junk))
