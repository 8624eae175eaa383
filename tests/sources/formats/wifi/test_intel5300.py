from __future__ import annotations

import numpy as np
from wifi_captures import integers, intel5300

from chachart.sources.formats.wifi.intel5300 import read
from chachart.sources.formats.wifi.log import Log

CSI = integers(5, 30, 3, 2)


def log_of(data: bytes) -> Log:
    return read(np.frombuffer(data, np.uint8))


def placed(csi: np.ndarray) -> np.ndarray:
    """(frames, antennas, streams, subcarriers)."""
    return csi.transpose(0, 2, 3, 1)


def test_values_columns_and_subcarriers() -> None:
    [group] = log_of(intel5300(CSI)).groups
    np.testing.assert_array_equal(group.csi, placed(CSI))
    assert group.kind.antenna_names == ("A", "B", "C")
    assert group.kind.tones.numbers == (*range(-28, -1, 2), -1, *range(1, 28, 2), 28)
    np.testing.assert_array_equal(np.diff(group.columns["time"]), 500_000)
    total = 10 * np.log10(10**4.0 + 10**4.1 + 10**4.2) - 44 - 30
    np.testing.assert_allclose(group.columns["rssi_dbm"], total, rtol=1e-6)


def test_every_number_of_antennas_and_streams() -> None:
    for antennas in (1, 2, 3):
        for sent in (1, 2, 3):
            csi = integers(3, 30, antennas, sent, limit=128, seed=antennas * sent)
            [group] = log_of(intel5300(csi)).groups
            np.testing.assert_array_equal(group.csi, placed(csi))


def test_chains_are_put_in_the_order_of_connectors() -> None:
    [group] = log_of(intel5300(CSI, order="201") + intel5300(CSI)).groups
    np.testing.assert_array_equal(group.csi[:5], placed(CSI[:, :, [1, 2, 0]]))
    np.testing.assert_array_equal(group.csi[5:], placed(CSI))


def test_two_antennas_are_named_by_their_connectors() -> None:
    two = CSI[:, :, :2]
    kinds = [group.kind for group in log_of(intel5300(two, "02") + intel5300(two, "21")).groups]
    assert [kind.antenna_names for kind in kinds] == [("A", "C"), ("B", "C")]
    assert kinds[1].differs_in(kinds[0], log_of(intel5300(two)).order) == "other antennas"


def test_40_mhz_by_the_rate() -> None:
    kinds = [group.kind for group in log_of(intel5300(CSI) + intel5300(CSI, rate=0x1901)).groups]
    assert kinds[1].tones.numbers == tuple(range(-58, 59, 4))
    assert kinds[1].bandwidth_hz == 40e6
    assert kinds[1].differs_in(kinds[0], log_of(intel5300(CSI)).order) == "other bandwidth"


def test_senders_by_the_payload_in_front_however_long() -> None:
    data = intel5300(CSI, senders=[1, 2, 0, 1, 2], payload=bytes(1400))
    log = log_of(data)
    assert log.has_senders
    stations = 0x0200_0000_0000 + np.array([1, 2, 0, 1, 2])
    stations[2] = 0
    np.testing.assert_array_equal(log.groups[0].columns["ue"], stations)


def test_the_wsr_fork() -> None:
    log = log_of(intel5300(CSI, fork=True))
    [group] = log.groups
    np.testing.assert_array_equal(group.csi, placed(CSI))
    assert (group.columns["ue"] == 0x0200_0000_0009).all()
    np.testing.assert_array_equal(group.columns["frame_count"], np.arange(5))
    assert group.columns["host_time"][0] == 1_600_000_000_000_005_000


def test_the_clock_wraps_and_steps_back() -> None:
    clock = np.array([2**32 - 100, 2**32 + 400, 900 + 2**32, 300 + 2**32, 800 + 2**32])
    [group] = log_of(intel5300(CSI, clock=clock)).groups
    np.testing.assert_array_equal(np.diff(group.columns["time"]), np.diff(clock) * 1000)


def test_a_cut_record_costs_itself() -> None:
    log = log_of(intel5300(CSI)[:-5])
    assert (len(log.groups[0]), dict(log.left_out), log.frames) == (4, {"cut short": 1}, 4)


def test_a_length_that_makes_no_sense_costs_its_record() -> None:
    one = len(intel5300(CSI[:1]))
    data = bytearray(intel5300(CSI))
    data[2 * one : 2 * one + 2] = b"\xff\xff"
    log = log_of(bytes(data))
    np.testing.assert_array_equal(log.groups[0].csi, placed(CSI[[0, 1, 3, 4]]))
    assert dict(log.left_out) == {"broken record": 1}


def test_a_record_whose_antennas_do_not_fit_costs_itself() -> None:
    data = bytearray(intel5300(CSI))
    data[3 + 8] = 2
    log = log_of(bytes(data))
    assert (len(log.groups[0]), dict(log.left_out), log.frames) == (4, {"broken record": 1}, 5)


def test_zeros_behind_the_last_record_are_nothing() -> None:
    log = log_of(intel5300(CSI) + bytes(100))
    assert (len(log.groups[0]), dict(log.left_out)) == (5, {})


def test_long_runs_and_blocks() -> None:
    csi = integers(9000, 30, 2, 1)
    [group] = log_of(intel5300(csi, order="01")).groups
    np.testing.assert_array_equal(group.csi, placed(csi))
