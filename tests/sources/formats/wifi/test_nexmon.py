from __future__ import annotations

import numpy as np
import pytest
from wifi_captures import (
    integers,
    nexmon,
    nexmon_packets,
    nexmon_payload,
    pcap,
    pcapng,
    station,
    udp,
)

from chachart.sources.formats.wifi.log import Log
from chachart.sources.formats.wifi.nexmon import Payloads, read, read_payloads

CSI = integers(6, 4, 64, limit=2000)


def log_of(data: bytes) -> Log:
    return read(np.frombuffer(data, np.uint8))


@pytest.mark.parametrize("container", [pcap, pcapng])
def test_the_cores_of_a_frame_are_put_together(container: type) -> None:
    log = log_of(container(nexmon_packets(CSI, missing=(5, 23))))
    [group] = log.groups
    np.testing.assert_array_equal(group.csi[:, :, 0], CSI[[0, 2, 3, 4]])
    np.testing.assert_array_equal(group.number, [0, 2, 3, 4])
    np.testing.assert_array_equal(group.columns["time"] - 100_000_000_000, np.array([0, 2, 3, 4]) * 10**6)
    assert dict(log.left_out) == {"incomplete": 2}


def test_repeated_sequence_numbers_begin_new_frames() -> None:
    [group] = log_of(nexmon(CSI, seq=[7] * 6)).groups
    np.testing.assert_array_equal(group.csi[:, :, 0], CSI)
    one = CSI[:, :1]
    [group] = log_of(nexmon(one, seq=[0] * 6)).groups
    np.testing.assert_array_equal(group.csi[:, :, 0], one)


@pytest.mark.parametrize(
    ("size", "used", "overwritten", "carrier_hz"),
    [(64, 56, (28,), 5.18e9), (128, 114, (2,), 5.19e9), (256, 242, (2,), 5.21e9)],
)
def test_subcarriers_and_channel(
    size: int, used: int, overwritten: tuple[int, ...], carrier_hz: float
) -> None:
    [group] = log_of(nexmon(integers(2, 1, size, limit=2000))).groups
    kind = group.kind
    assert kind.tones.numbers == tuple(range(-size // 2, size // 2))
    assert (len(kind.tones.used), kind.tones.weak) == (used, overwritten)
    assert (kind.carrier_hz, kind.bandwidth_hz) == (carrier_hz, size * 312_500)


def test_rssi_where_the_firmware_tells_it() -> None:
    assert log_of(nexmon(CSI)).groups[0].columns["rssi_dbm"].tolist() == [-50] * 6
    words = np.arange(-32, 32, dtype="<i2").repeat(2).tobytes()
    old = [(1.0, udp(nexmon_payload(words, station(1), 0, 0, rssi=0)))]
    assert "rssi_dbm" not in log_of(pcap(old)).groups[0].columns


def float_words(mantissa: int, exponent: int) -> tuple[np.ndarray, np.ndarray]:
    """Words of a chip with numbers of its own, and what they mean."""
    rng = np.random.default_rng(3)
    largest = (1 << (mantissa - 1)) - 1
    real, imag = rng.integers(-largest, largest + 1, (2, 64))
    power = rng.integers(-(1 << (exponent - 1)), 1 << (exponent - 1), 64)
    words = power & ((1 << exponent) - 1)
    for part, low in ((imag, exponent), (real, exponent + mantissa)):
        words |= (np.abs(part) << low) | ((part < 0).astype(np.int64) << (low + mantissa - 1))
    return words.astype("<u4"), (real + 1j * imag) * 2.0**power


@pytest.mark.parametrize(("mantissa", "exponent"), [(9, 5), (12, 6)])
def test_chips_with_numbers_of_their_own_are_told_by_the_words(mantissa: int, exponent: int) -> None:
    words, values = float_words(mantissa, exponent)
    data = pcap([(1.0, udp(nexmon_payload(words.tobytes(), station(1), n, 0))) for n in range(3)])
    [group] = log_of(data).groups
    np.testing.assert_allclose(group.csi[2, 0, 0], np.fft.fftshift(values), rtol=1e-6)


def test_datagrams_alone_are_enough() -> None:
    payloads = []
    for n, frame in enumerate(CSI[:, :1]):
        values = np.fft.ifftshift(frame[0])
        words = np.stack([values.real, values.imag], -1).astype("<i2").tobytes()
        payloads.append(nexmon_payload(words, station(1), n, 0))
    lengths = np.array([len(p) for p in payloads])
    data = np.frombuffer(b"".join(payloads), np.uint8)
    found = Payloads(np.cumsum(lengths) - lengths, lengths, np.arange(len(payloads)))
    [group] = read_payloads(data, found).groups
    np.testing.assert_array_equal(group.csi[:, :, 0], CSI[:, :1])


def test_bandwidths_are_kinds_and_a_cut_packet_costs_itself() -> None:
    wide = integers(3, 4, 128, limit=2000)
    log = log_of((nexmon(CSI) + nexmon(wide)[24:])[:-40])
    assert [len(group) for group in log.groups] == [6, 2]
    assert log.groups[1].kind.differs_in(log.groups[0].kind, log.order) == "other bandwidth"
    assert dict(log.left_out) == {"cut short": 1, "incomplete": 1}


def test_a_packet_length_that_makes_no_sense_costs_its_packet() -> None:
    one = CSI[:, :1]
    data = bytearray(nexmon(one, seq=[0] * 6))
    third = 24 + (16 + 20) + sum(16 + len(packet) for _, packet in nexmon_packets(one)[1:3])
    data[third + 8 : third + 12] = b"\xff\xff\xff\xff"
    log = log_of(bytes(data))
    np.testing.assert_array_equal(log.groups[0].csi[:, :, 0], one[[0, 1, 3, 4, 5]])
    assert dict(log.left_out) == {"broken record": 1}


def test_other_traffic_is_passed_over() -> None:
    log = log_of(pcap([(1.0, bytes(60)), (1.1, udp(b"something else")), (1.2, b"")]))
    assert (log.groups, log.frames) == ([], 0)
    with pytest.raises(ValueError, match="no CSI frames"):
        log.commonest()
