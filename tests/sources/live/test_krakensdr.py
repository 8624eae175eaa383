"""The source `krakensdr`: heimdall's frames, channels on the air, and a simulated receiver over TCP."""

from __future__ import annotations

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.sources.live.device import CodecError
from chachart.sources.live.krakensdr import heimdall
from chachart.sources.live.krakensdr.bursts import bursts, channelise, factor
from chachart.sources.live.krakensdr.heimdall import Header
from chachart.sources.live.krakensdr.receiver import KrakenFaults, SimulatedKraken, Transmitter
from chachart.sources.live.krakensdr.source import KrakenSettings, KrakenSource

ARRAY = ArrayGeometry("kraken", 5, 16, 433e6, 12_500.0, 0.3)
SMALL = {"samples": 4096, "rate_hz": 1_000_000}


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> SourceCase:
        return SourceCase("krakensdr", {"loopback": SMALL}, ARRAY)


@given(
    st.sampled_from([heimdall.DATA, heimdall.CALIBRATION, heimdall.DUMMY]),
    st.integers(1, 8),
    st.integers(1, 32),
    st.integers(0, 2**31),
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.booleans(),
)
def test_a_frame_comes_back(
    kind: int, channels: int, samples: int, index: int, overdrive: int, delay: bool, phase: bool
) -> None:
    header = Header(
        kind,
        channels,
        samples,
        32,
        433_000_000,
        2_400_000,
        1_700_000_000_000_000_000,
        index,
        overdrive,
        delay,
        phase,
    )
    rng = np.random.default_rng(index)
    sent = rng.standard_normal((channels, 2 * samples)).astype(np.float32).view(np.complex64)
    wire = heimdall.encode_frame(header, sent)
    assert heimdall.decode_header(wire[: heimdall.HEADER_BYTES]) == header
    payload = wire[heimdall.HEADER_BYTES :]
    assert len(payload) == header.payload_bytes
    if kind != heimdall.DUMMY:
        np.testing.assert_array_equal(heimdall.decode_samples(header, payload), sent)


@given(st.binary(max_size=1024))
def test_any_bytes_are_a_header_or_a_reason(data: bytes) -> None:
    for header in (data, struct.pack("<I", heimdall.SYNC) + data.ljust(1020, b"\0")[:1020]):
        with suppress(CodecError):
            assert (
                heimdall.decode_header(header).payload_bytes
                <= 8 * heimdall.MOST_CHANNELS * heimdall.MOST_SAMPLES
            )


def test_the_header_has_the_gaps_of_the_c_structure() -> None:
    header = Header(heimdall.DATA, 5, 64, 32, 433_000_000, 2_400_000, 10**18, 7, 3, True, False)
    wire = heimdall.encode_frame(header, np.zeros((5, 64), np.complex64))
    at = {0: heimdall.SYNC, 28: 5, 64: 64, 84: 7, 100: 32, 104: 3, 236: 1, 240: 0}
    assert {offset: struct.unpack_from("<I", wire, offset)[0] for offset in at} == at
    assert struct.unpack_from("<Q", wire, 40)[0] == 433_000_000
    assert struct.unpack_from("<Q", wire, 56)[0] == 2_400_000
    assert struct.unpack_from("<Q", wire, 72)[0] == 10**12


def test_a_tone_is_in_its_channel() -> None:
    n = 4096
    tone = np.exp(2j * np.pi * 250_000 / 1e6 * np.arange(n))[None].astype(np.complex64)
    power = np.abs(channelise(tone, 1e6, 31_250.0)[:, 0]).mean(axis=1)
    assert power.argmax() - 16 == 8


@given(st.integers(1, 6), st.integers(0, 10), st.integers(0, 2**32 - 1))
def test_a_factor_has_its_covariance(m: int, more: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((m, 3)) + 1j * rng.standard_normal((m, 3))
    r = x @ x.conj().T
    f = factor(r, m + more)
    np.testing.assert_allclose(f @ f.conj().T / (m + more), r, atol=1e-5 * np.abs(r).max())


def test_noise_alone_is_no_transmitter() -> None:
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((5, 2 * 65536)).astype(np.float32).view(np.complex64)
    assert bursts(noise, 433e6, 1e6, 12_500.0, 6.0) == []


def test_directions_come_out_and_frames_that_are_not_good_are_counted_exactly() -> None:
    transmitters = (
        Transmitter(offset_hz=200_000.0, azimuth_deg=50.0, snr_db=0.0),
        Transmitter(offset_hz=-300_000.0, azimuth_deg=110.0, snr_db=0.0),
    )
    loopback = KrakenFaults(
        **SMALL, frames=400, transmitters=transmitters, unsynchronous=0.1, overdrive=0.1, calibrating=0.1
    )
    estimator = ChartEstimator(ARRAY, theta="music", averaging="mean")
    with KrakenSource(KrakenSettings(loopback=loopback), ARRAY) as source:
        blocks = receive(source, 100_000)
        assert isinstance(source.simulated, SimulatedKraken)
        report = source.simulated.report
        rejected = source.rejected.as_dict()
        details = source.details()
    assert details["acquisitions"] == 400
    assert details["missed"] == 0
    assert rejected == {
        "not_synchronous": report.unsynchronous,
        "overdrive": report.overdriven,
        "calibrating": report.calibrating,
    }
    assert sum(len(b) for b in blocks) == 2 * report.good
    found: dict[int, float] = {}
    for block in blocks:
        update = estimator.update(block)
        found.update(zip(update.ue.tolist(), np.degrees(update.theta).tolist(), strict=True))
    assert found == {
        433_200_000: pytest.approx(50.0, abs=0.2),
        432_700_000: pytest.approx(110.0, abs=0.2),
    }


def test_too_few_subcarriers_for_a_covariance_are_told() -> None:
    array = ArrayGeometry("kraken", 5, 4, 433e6, 12_500.0, 0.3)
    with pytest.raises(SetupError, match="subcarriers = 4"):
        KrakenSource(KrakenSettings(loopback=True), array).open()
