import numpy as np
import pytest

from chachart.sources.frontend.clock import DeviceClock

OFFSET_NS = 1_700_000_000_000_000_000


def arrivals(rng: np.random.Generator, drift: float, seconds: float, rate_hz: float = 200.0):
    """Device and host time of frames, 0.2 ms on the way and now and then much longer."""
    device = np.arange(1, seconds * rate_hz) / rate_hz * 1e9
    delay = 0.2e6 + rng.exponential(1e6, len(device)) + (rng.random(len(device)) < 0.02) * 300e6
    host = OFFSET_NS + np.int64(device * (1 + drift) + delay)
    return device.astype(np.int64).tolist(), host.tolist()


@pytest.mark.parametrize("drift", [0.0, 50e-6, -200e-6])
def test_offset_and_drift_are_found_through_late_frames(drift):
    clock = DeviceClock()
    device, host = arrivals(np.random.default_rng(1), drift, 40)
    mapped = [clock.observe(d, h) for d, h in zip(device, host, strict=True)]
    assert clock.drift == pytest.approx(drift, abs=2e-6)
    true = OFFSET_NS + np.array(device) * (1 + drift)
    assert np.abs(np.array(mapped[-1000:]) - true[-1000:]).max() < 0.5e6
    details = clock.details()
    assert details["jumps"] == 0
    assert details["drift_ppm"] == pytest.approx(drift * 1e6, abs=2)
    assert details["offset_s"] == pytest.approx(OFFSET_NS / 1e9, abs=0.1)


def test_a_stalled_host_does_not_move_the_clock():
    clock = DeviceClock()
    device, host = arrivals(np.random.default_rng(2), 0.0, 20)
    for n, (d, h) in enumerate(zip(device, host, strict=True)):
        stalled = max(h, host[0] + 13_000_000_000) if 10 < n / 200 < 12.9 else h
        mapped = clock.observe(d, stalled)
        assert abs(mapped - OFFSET_NS - d) < 5e6 + 300e6 * (n < 200)
    assert clock.jumps == 0


@pytest.mark.parametrize("step_s", [-30, 30])
def test_a_clock_that_is_set_is_followed(step_s):
    clock = DeviceClock()
    device, host = arrivals(np.random.default_rng(3), 0.0, 20)
    half = len(device) // 2
    shifted = device[:half] + [d + step_s * 10**9 + 40 * 10**9 for d in device[half:]]
    start = [d + 40 * 10**9 for d in shifted[:half]] + shifted[half:]
    for d, h in zip(start, host, strict=True):
        mapped = clock.observe(d, h)
    assert clock.jumps == 1
    assert abs(mapped - host[-1]) < 400e6


def test_a_device_without_a_clock_gets_the_time_of_arrival():
    clock = DeviceClock()
    assert [clock.observe(0, t) for t in (5, 9, 7)] == [5, 9, 7]
    assert clock.details() == {"offset_s": 0.0, "drift_ppm": 0.0, "jumps": 0}
