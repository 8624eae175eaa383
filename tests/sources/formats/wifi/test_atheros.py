from __future__ import annotations

import struct

import numpy as np
import pytest
from wifi_captures import atheros, integers, packet_of, station

from chachart.sources.formats.wifi.atheros import read, why_not
from chachart.sources.formats.wifi.log import Log

CSI = integers(5, 56, 3, 2, limit=500)


def log_of(data: bytes) -> Log:
    return read(np.frombuffer(data, np.uint8))


WAYS = {
    "little endian": atheros(CSI),
    "big endian": atheros(CSI, ">"),
    "flag, little endian": b"\x00" + atheros(CSI),
    "flag, big endian": b"\xff" + atheros(CSI, ">"),
    "BPI-R2": atheros(CSI, "<", lengths=">"),
}


@pytest.mark.parametrize("data", WAYS.values(), ids=WAYS)
def test_every_way_to_write_it(data: bytes) -> None:
    assert why_not(data) is None
    [group] = log_of(data).groups
    np.testing.assert_array_equal(group.csi, CSI.transpose(0, 2, 3, 1))
    np.testing.assert_array_equal(group.columns["time"], (7000 + np.arange(5)) * 1000)
    assert (group.kind.carrier_hz, group.kind.bandwidth_hz) == (2.412e9, 20e6)
    np.testing.assert_array_equal(group.columns["rssi"][0], [41, 42, 43])
    np.testing.assert_array_equal(group.columns["rssi_dbm"], 40.0 - 95)


def test_every_number_of_antennas_streams_and_tones() -> None:
    for antennas in (1, 2, 3):
        for sent in (1, 2, 3):
            for tones in (56, 114):
                csi = integers(2, tones, antennas, sent, limit=512, seed=antennas * sent)
                [group] = log_of(atheros(csi)).groups
                np.testing.assert_array_equal(group.csi, csi.transpose(0, 2, 3, 1))
                assert group.kind.tones.numbers is not None


def test_senders_by_the_packet() -> None:
    log = log_of(atheros(CSI, payload=packet_of(station(7))))
    assert log.has_senders
    assert (log.groups[0].columns["ue"] == 0x0200_0000_0007).all()
    assert not log_of(atheros(CSI)).has_senders


def test_streams_that_differ_are_other_kinds() -> None:
    log = log_of(atheros(CSI[..., :1]) + atheros(CSI) + atheros(CSI[..., :1]))
    assert [len(group) for group in log.groups] == [10, 5]
    np.testing.assert_array_equal(log.groups[1].number, np.arange(5, 10))
    assert log.groups[1].kind.differs_in(log.groups[0].kind, log.order) == "other shape"


def test_cut_and_damaged_records_cost_themselves() -> None:
    one = len(atheros(CSI[:1]))
    assert dict(log_of(atheros(CSI)[:-5]).left_out) == {"cut short": 1}
    data = bytearray(atheros(CSI))
    data[3 * one : 3 * one + 2] = b"\xff\xff"
    log = log_of(bytes(data))
    np.testing.assert_array_equal(log.groups[0].csi, CSI[[0, 1, 2, 4]].transpose(0, 2, 3, 1))
    assert dict(log.left_out) == {"broken record": 1}


def test_packets_without_csi_are_told() -> None:
    silent = bytearray(2 + 25)
    silent[0] = 25
    log = log_of(atheros(CSI) + bytes(silent))
    assert (log.frames, log.remarks) == (5, ["1 packets without CSI"])


def test_records_that_do_not_hold_the_whole_packet() -> None:
    payload = packet_of(station(7)) + bytes(40)
    one = len(atheros(CSI[:1], payload=payload))
    records = [atheros(CSI[n : n + 1], payload=payload) for n in range(5)]
    cut = [struct.pack("<H", one - 2 - 40) + record[2:-40] for record in records]
    [group] = log_of(b"".join(cut)).groups
    np.testing.assert_array_equal(group.csi, CSI.transpose(0, 2, 3, 1))
    assert set(group.columns["ue"].tolist()) == {0x0200_0000_0007}
    none = [struct.pack("<H", one - 2 - len(payload)) + record[2 : -len(payload)] for record in records]
    [group] = log_of(b"".join(none)).groups
    assert set(group.columns["ue"].tolist()) == {0}
