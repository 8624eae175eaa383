import time

import numpy as np
import pytest
from source_contract import SourceCase, SourceContract

from chachart.config.settings import ArraySettings
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.base import EndOfSource
from chachart.sources.scenario.channel import channels
from chachart.sources.scenario.layout import place
from chachart.sources.simulator import LINGER_S, Simulator, SimulatorSettings

ARRAY = ArraySettings(antennas=8, subcarriers=4).geometry()


class TestSimulatorKeepsTheContract(SourceContract):
    @pytest.fixture(params=[0, 2000.0], ids=["lossless", "live"])
    def case(self, request):
        return SourceCase("simulator", {"ues": 10, "frame_rate_hz": request.param}, ARRAY)


class FakeTime:
    """A clock that only `sleep` moves, so that pace can be told apart from the machine's speed."""

    def __init__(self):
        self.now = 1000.0
        self.slept = []

    def clock(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def drain(array=ARRAY, **settings):
    """All frames of a simulator that ends, as one block."""
    blocks = []
    with Simulator(SimulatorSettings(**{"frame_rate_hz": 0, **settings}), array) as source:
        while True:
            try:
                block = source.recv(5.0)
            except EndOfSource:
                return CsiBlock.concatenate(blocks)
            if block is not None:
                assert block.seq == sum(len(b) for b in blocks)
                assert len(block) <= source.settings.block_frames
                blocks.append(block)


def paced(fake, **settings):
    source = Simulator(SimulatorSettings(**settings), ARRAY, fake.clock, fake.sleep)
    source.open()
    return source


def test_ues_take_turns_and_the_source_ends_after_its_frames():
    block = drain(ues=30, frames=100, block_frames=17)
    np.testing.assert_array_equal(block.ue, np.arange(100) % 30)
    assert np.all(np.diff(block.time_ns) > 0)
    assert block.array == ARRAY.name
    assert block.csi.shape == (100, 8, 4)


def test_frames_are_the_channel_and_noise_at_the_given_snr():
    block = drain(ues=300, frames=9000, snr_db=6.0)
    clean = channels("los", place("vip", 300, ARRAY), ARRAY)
    noise = block.csi - clean[block.ue.astype(int)]
    assert np.mean(np.abs(clean) ** 2) == pytest.approx(1.0, rel=1e-4)
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(10**-0.6, rel=0.01)
    assert np.var(noise.real) == pytest.approx(np.var(noise.imag), rel=0.02)
    assert abs(np.mean(noise[:-1] * noise[1:].conj())) < 0.005


def test_same_seed_same_frames_however_they_are_cut():
    settings = {"ues": 50, "frames": 120, "motion": "waypoint", "speed_m_s": 20.0, "random_phase": True}
    one = drain(seed=3, block_frames=64, **settings)
    again = drain(seed=3, block_frames=7, **settings)
    other = drain(seed=4, **settings)
    np.testing.assert_allclose(one.csi, again.csi, atol=1e-6)
    np.testing.assert_array_equal(one.position, again.position)
    assert not np.allclose(one.csi, other.csi)


def test_moving_ues_move_and_their_channels_with_them():
    block = drain(ues=3, frames=300, motion="waypoint", speed_m_s=1.5, snr_db=100.0)
    first = block.take(block.ue == 0)
    assert np.linalg.norm(first.position[-1] - first.position[0]) == pytest.approx(1.5 * 9.9, rel=1e-3)
    turn = np.angle(np.sum(first.csi[1:] * first.csi[:-1].conj(), axis=(1, 2)))
    distance = np.linalg.norm(first.position.astype(float) - ARRAY.element_positions().mean(axis=0), axis=1)
    expected = -2 * np.pi * np.diff(distance) / ARRAY.wavelength_m
    np.testing.assert_allclose(np.exp(1j * turn), np.exp(1j * expected), atol=0.02)


def test_a_random_phase_turns_whole_frames():
    plain = drain(ues=1, frames=200, snr_db=100.0)
    turned = drain(ues=1, frames=200, snr_db=100.0, random_phase=True)
    ratio = turned.csi / plain.csi
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1, :1], ratio.shape), atol=1e-3)
    assert abs(np.mean(ratio[:, 0, 0])) < 0.2


@pytest.mark.parametrize(("known", "shown"), [(None, 20), (20, 20), (5, 5), (0, 0)])
def test_positions_are_shown_of_as_many_ues_as_asked(known, shown):
    block = drain(ues=20, frames=40, known_ues=known)
    if shown == 0:
        assert block.position is None
        return
    np.testing.assert_array_equal(np.isfinite(block.position).all(axis=1), block.ue < shown)
    truth = place("vip", 20, ARRAY)[: min(shown, 20)]
    np.testing.assert_allclose(block.position[:shown], truth, rtol=1e-6)


def test_a_live_simulator_keeps_its_frame_rate():
    fake = FakeTime()
    source = paced(fake, ues=10, frame_rate_hz=1000.0, block_frames=64)
    assert not source.lossless
    blocks = [source.recv(1.0) for _ in range(200)]
    frames = sum(len(b) for b in blocks)
    elapsed = fake.now - 1000.0
    assert frames == pytest.approx(1000.0 * elapsed, abs=2)
    assert all(0 < seconds <= LINGER_S + 1e-9 for seconds in fake.slept)
    assert np.diff(np.concatenate([b.time_ns for b in blocks])) == pytest.approx(1e6, abs=2)


def test_recv_gives_up_when_nothing_is_due_in_time():
    fake = FakeTime()
    source = paced(fake, ues=1, frame_rate_hz=2.0)
    assert len(source.recv(1.0)) == 1
    before = fake.now
    assert source.recv(0.1) is None
    assert fake.now == pytest.approx(before + 0.1)
    assert len(source.recv(1.0)) == 1


def test_a_simulator_that_cannot_keep_up_skips_time_and_says_so(caplog):
    fake = FakeTime()
    source = paced(fake, ues=10, frame_rate_hz=1000.0, block_frames=10)
    source.recv(1.0)
    fake.now += 60.0
    late = [source.recv(1.0) for _ in range(3)]
    assert source.details()["skipped_s"] == pytest.approx(60, abs=0.1)
    assert late[-1].time_ns[0] - late[0].time_ns[0] < 1e9
    assert "skipping time" in caplog.text


def test_a_lossless_simulator_never_waits():
    fake = FakeTime()
    source = paced(fake, ues=10, frame_rate_hz=0)
    assert source.lossless
    for _ in range(50):
        assert len(source.recv(0.0) or source.recv(0.0)) == 64
    assert fake.slept == []


def test_preparing_channels_does_not_hold_up_recv():
    source = Simulator(SimulatorSettings(frame_rate_hz=0), ArraySettings().geometry())
    source.open()
    assert source.details()["channels_ready"] == 0
    assert source.recv(0.0) is None
    assert 0 < source.details()["channels_ready"] < 1
    deadline = time.monotonic() + 30
    while source.recv(0.0) is None:
        assert time.monotonic() < deadline
    assert source.details()["channels_ready"] == 1
    source.close()
    source.close()


def test_an_oversized_block_is_refused_with_what_would_fit():
    array = ArraySettings(antennas=1024, subcarriers=4096).geometry()
    with pytest.raises(SetupError, match=r"block_frames = 64.*at most 8 frames"):
        Simulator(SimulatorSettings(), array).open()
    Simulator(SimulatorSettings(block_frames=8, ues=1), array).open()


def test_too_many_ues_for_multipath_are_a_problem_before_anything_starts():
    too_many = SimulatorSettings(channel="qnlos", ues=60_000)
    assert "at most 50000" in Simulator.problems(too_many)[0]
    with pytest.raises(SetupError, match="at most 50000"):
        Simulator(too_many, ARRAY).open()
    assert Simulator.problems(SimulatorSettings(ues=60_000)) == []


@pytest.mark.parametrize("channel", ["qlos", "qnlos"])
@pytest.mark.parametrize("motion", ["static", "waypoint"])
def test_multipath_channels_come_through_with_unit_mean_power(channel, motion):
    block = drain(ues=400, frames=400, channel=channel, motion=motion, snr_db=100.0)
    assert np.mean(np.abs(block.csi) ** 2) == pytest.approx(1, rel=0.1)
    if motion == "static":
        clean = channels(channel, place("vip", 400, ARRAY), ARRAY)
        np.testing.assert_allclose(block.csi, clean, atol=1e-3)


def test_more_ues_than_fit_in_memory_are_computed_frame_by_frame(monkeypatch):
    from chachart.sources import simulator

    cached = drain(ues=40, frames=80, layout="grid", snr_db=60.0)
    monkeypatch.setattr(simulator, "_CACHE_BYTES", 39 * 8 * 8 * 4)
    fresh = drain(ues=40, frames=80, layout="grid", snr_db=60.0)
    ratio = fresh.csi / cached.csi
    np.testing.assert_allclose(ratio, np.mean(ratio), rtol=0.02)
    assert abs(np.mean(ratio)) == pytest.approx(1, abs=0.05)


def test_the_whole_interface_of_settings_is_strict():
    for wrong in [{"channel": "nope"}, {"ues": 0}, {"frame_rate_hz": -1}, {"speed": 3}]:
        with pytest.raises(ValueError, match=next(iter(wrong))):
            SimulatorSettings(**wrong)


def test_an_area_and_heights_of_ones_own():
    block = drain(ues=500, frames=500, area_m=(2.0, 8.0, -3.0, 3.0), ue_height_m=0.5, ue_highest_m=2.0)
    ahead, along, up = block.position.T
    assert (ahead.min() >= 2, ahead.max() <= 8, along.min() >= -3, along.max() <= 3) == (True,) * 4
    assert up.min() >= 0.5
    assert up.max() <= 2
    assert np.ptp(up) > 1.4


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"area_m": (8.0, 2.0, -3.0, 3.0)}, "nearest < farthest"),
        ({"ue_highest_m": 0.0}, "at least ue_height_m"),
    ],
)
def test_what_is_no_area_is_said(settings, says):
    [problem] = Simulator.problems(SimulatorSettings(**settings))
    assert says in problem


def test_simulators_in_step_hear_the_same_transmissions():
    """Two arrays, started one after the other: a number stands for one UE at one time and place."""
    heard = []
    for y in (0.0, 8.0):
        array = ArraySettings(antennas=8, subcarriers=4, position_m=(5.0, y, 2.0)).geometry()
        settings = SimulatorSettings(
            ues=5,
            motion="waypoint",
            area_m=(1, 9, 1, 7),
            area_in="world",
            in_step=True,
            frame_rate_hz=500.0,
            frames=600,
        )
        with Simulator(settings, array) as source:
            blocks = []
            while sum(map(len, blocks)) < 100:
                block = source.recv(5.0)
                blocks += [] if block is None else [block]
        heard.append(CsiBlock.concatenate(blocks))
    for block in heard:
        assert (np.diff(block.packet.astype(np.int64)) >= 1).all()
        assert (block.position[:, :2] > (1, 1)).all()
        assert (block.position[:, :2] < (9, 7)).all()
        np.testing.assert_array_equal(block.ue, (block.packet - 1) % 5)
        np.testing.assert_allclose(block.time_ns, (block.packet - 1) / 500.0 * 1e9, atol=1e3)
        assert np.abs(block.time_ns / 1e9 - time.time()).max() < 60


def test_a_simulator_in_step_skips_what_it_is_late_with():
    fake = FakeTime()
    source = paced(fake, in_step=True, frame_rate_hz=100.0, ues=3)
    while (before := source.recv(1.0)) is None:
        pass
    fake.now += 5.0
    while (after := source.recv(1.0)) is None:
        pass
    assert after.seq == before.seq + len(before)
    assert source.details()["skipped_s"] > 4


def test_keeping_step_needs_a_rate():
    assert "frame_rate_hz" in Simulator.problems(SimulatorSettings(in_step=True, frame_rate_hz=0))[0]
