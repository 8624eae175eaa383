from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from wifi_captures import atheros, esp32, intel5300, nexmon

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import frames
from chachart.sources.formats.base import Capture


def integers(*shape: int, limit: int = 100) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.integers(-limit, limit, shape) + 1j * rng.integers(-limit, limit, shape)


INTEL = integers(5, 30, 3, 2)
ATHEROS = integers(5, 56, 3, 2, limit=500)
NEXMON = integers(6, 4, 64, limit=2000)
ESP32 = integers(5, 64)
WRITTEN = {
    "intel5300": intel5300(INTEL),
    "atheros": atheros(ATHEROS),
    "nexmon": nexmon(NEXMON),
    "esp32": esp32(ESP32),
}

Open = Callable[[bytes], Capture]


@pytest.fixture
def opened(tmp_path: Path) -> Open:
    """Opens a capture that holds the given bytes."""

    def open_bytes(data: bytes) -> Capture:
        path = tmp_path / "capture.bin"
        path.write_bytes(data)
        return open_capture(path)

    return open_bytes


def csi_of(capture: Capture, name: str = "csi") -> np.ndarray:
    return frames(capture.read(name), capture.axes)


def test_intel_5300(opened: Open) -> None:
    capture = opened(intel5300(INTEL))
    assert capture.format == "Intel 5300 .dat"
    for name, stream in (("csi", 0), ("csi_1", 1)):
        np.testing.assert_array_equal(csi_of(capture, name), INTEL[..., stream].transpose(0, 2, 1))
    np.testing.assert_array_equal(np.diff(capture.read("time")), 500_000)
    turned = csi_of(opened(intel5300(INTEL, order="201")))
    np.testing.assert_array_equal(turned, INTEL[:, :, [1, 2, 0], 0].transpose(0, 2, 1))


@pytest.mark.parametrize("order", ["<", ">"])
def test_atheros(opened: Open, order: str) -> None:
    capture = opened(atheros(ATHEROS, order))
    assert capture.format == "Atheros .dat"
    np.testing.assert_array_equal(csi_of(capture, "csi_1"), ATHEROS[..., 1].transpose(0, 2, 1))
    np.testing.assert_array_equal(capture.read("time"), (7000 + np.arange(5)) * 1000)


def test_nexmon_puts_the_cores_of_a_frame_together(opened: Open) -> None:
    capture = opened(nexmon(NEXMON, missing=(5, 23)))
    assert capture.format == "Nexmon .pcap"
    np.testing.assert_array_equal(csi_of(capture), NEXMON[[0, 2, 3, 4]])
    np.testing.assert_array_equal(capture.read("ue"), 256 + np.array([0, 2, 3, 4]))
    np.testing.assert_array_equal(capture.read("time"), np.array([100, 102, 103, 104]) * 10**9 + 500_000)
    assert {"csi_4358", "csi_4366c0"} <= set(capture.variables)


def test_esp32(opened: Open) -> None:
    capture = opened(esp32(ESP32))
    assert capture.format == "ESP32 .csv"
    np.testing.assert_array_equal(csi_of(capture)[:, 0], ESP32)
    np.testing.assert_array_equal(np.diff(capture.read("time")), 20_000)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (intel5300(INTEL)[:-5], "ends within the record after CSI frame 4"),
        (intel5300(INTEL) + intel5300(INTEL[:, :, :2]), r"frame 5 has .* \(2, 2\), the first has \(3, 2\)"),
        (b"\0\5\xc1mpdu" * 9, "no CSI frames"),
        (atheros(ATHEROS)[:-5], "ends within frame 4"),
        (atheros(ATHEROS) + b"xyz", "lengths in frame 5 do not fit"),
        (atheros(ATHEROS) + atheros(ATHEROS[..., :1]), "frame 5 has"),
        (nexmon(NEXMON)[:-40], "ends within packet 23"),
        (nexmon(NEXMON, missing=tuple(4 * n + n % 2 for n in range(6))), "no frame has all"),
        (nexmon(NEXMON) + nexmon(integers(2, 4, 128))[24:], "a length of CSI"),
        (nexmon(NEXMON[:0]), "no CSI frames"),
        (esp32(ESP32)[:-5], r"line 6 has no \[\.\.\.\]"),
        (esp32(ESP32).replace(b" 1 ", b" x "), "something that is no number"),
        (esp32(ESP32) + b"\n" + esp32(ESP32[:, :32]), "frame 5 has a number of values"),
    ],
)
def test_what_is_wrong_is_told(opened: Open, data: bytes, words: str) -> None:
    with pytest.raises(SetupError, match=words):
        opened(data)


@pytest.mark.parametrize("kind", WRITTEN)
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_captures_give_an_error_or_arrays(opened: Open, kind: str, data: st.DataObject) -> None:
    damaged = bytearray(WRITTEN[kind])
    del damaged[data.draw(st.integers(0, len(damaged)), "length") :]
    for _ in range(data.draw(st.integers(0, 4), "flips") if damaged else 0):
        at = data.draw(st.integers(0, min(len(damaged), 200) - 1) | st.integers(0, len(damaged) - 1), "at")
        damaged[at] ^= data.draw(st.integers(1, 255), "by")
    try:
        capture = opened(bytes(damaged))
        for name in capture.variables:
            assert isinstance(capture.read(name), np.ndarray)
    except SetupError as error:
        event(str(error).rpartition(":")[2])
