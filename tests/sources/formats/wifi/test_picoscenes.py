from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from picoscenes_captures import SYSTEM_NS, picoscenes

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import frames
from chachart.sources.formats.wifi.capture import WifiCapture


def integers(*shape: int, limit: int = 100) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.integers(-limit, limit, shape) + 1j * rng.integers(-limit, limit, shape)


CSI = {
    "5300": integers(4, 30, 3, 2),
    "9300": integers(4, 56, 3, 2, limit=500),
    "ax200": integers(4, 56, 2, 2, limit=30000),
    "ax210": integers(4, 242, 2, 1, limit=30000),
    "usrp": integers(4, 52, 3, 2) / 8,
}
WRITTEN = {device: picoscenes(csi, device) for device, csi in CSI.items()}

Open = Callable[[bytes], WifiCapture]


@pytest.fixture
def opened(tmp_path: Path) -> Open:
    """Opens a capture that holds the given bytes."""

    def open_bytes(data: bytes) -> WifiCapture:
        path = tmp_path / "capture.bin"
        path.write_bytes(data)
        capture = open_capture(path)
        assert isinstance(capture, WifiCapture)
        return capture

    return open_bytes


def csi_of(capture: WifiCapture, name: str = "csi") -> np.ndarray:
    return frames(capture.read(name), capture.axes)


def assert_holds(capture: WifiCapture, csi: np.ndarray) -> None:
    assert capture.format == "PicoScenes .csi"
    for stream in range(csi.shape[3]):
        name = f"csi_{stream}" if stream else "csi"
        np.testing.assert_array_equal(csi_of(capture, name), csi[..., stream].transpose(0, 2, 1))


@pytest.mark.parametrize("device", CSI)
@pytest.mark.parametrize("version", [3, 4, 5, 6])
def test_csi_of_every_device_and_version(opened: Open, device: str, version: int) -> None:
    assert_holds(opened(picoscenes(CSI[device], device, csi_version=version)), CSI[device])


@pytest.mark.parametrize("device", ["5300", "9300", "usrp"])
@pytest.mark.parametrize("version", [1, 2])
def test_first_versions(opened: Open, device: str, version: int) -> None:
    data = picoscenes(CSI[device], device, csi_version=version, basic_version=version, frame_version=1)
    assert_holds(opened(data), CSI[device])


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("frame_version", [1, 2])
def test_times_and_senders(opened: Open, version: int, frame_version: int) -> None:
    capture = opened(picoscenes(CSI["ax210"], basic_version=version, frame_version=frame_version))
    np.testing.assert_array_equal(capture.read("timestamp"), (1000 + 5000 * np.arange(4)) * 1000)
    np.testing.assert_array_equal(capture.read("ue"), 0x0200_0000_0000 + np.arange(4))
    times = SYSTEM_NS + 5_000_000 * np.arange(4) if version >= 4 else capture.read("timestamp")
    np.testing.assert_array_equal(capture.read("time"), times)
    np.testing.assert_array_equal(capture.group.columns["noise"], -95)
    np.testing.assert_array_equal(capture.group.columns["rssi"], np.tile([-40, -41, -42], (4, 1)))


def test_chains_of_the_5300_are_put_in_the_order_of_antennas(opened: Open) -> None:
    chosen = 0b01_00_10
    turned = CSI["5300"][:, :, [1, 2, 0]]
    assert_holds(opened(picoscenes(CSI["5300"], "5300", chosen=chosen)), turned)


@pytest.mark.parametrize(
    ("mode", "tones", "unused"), [(3, 2020, range(996, 1024)), (2, 498, range(242, 256))]
)
def test_unused_subcarriers_at_160_mhz_are_left_out(
    opened: Open, mode: int, tones: int, unused: range
) -> None:
    csi = integers(2, tones, 2, 1)
    assert_holds(opened(picoscenes(csi, mode=(mode, 160))), np.delete(csi, unused, axis=1))


AX210 = WRITTEN["ax210"]
SECOND = picoscenes(CSI["ax210"][:1])
SECOND = SECOND[: len(SECOND) - SECOND[::-1].find(b"\x15\x03\x15\x20"[::-1]) - 8]
"""One frame that has CSI, without the one behind it that has none."""


@pytest.mark.parametrize(
    "broken",
    [
        SECOND[:4] + b"x" + SECOND[5:],
        SECOND.replace(b"\3CSI\6", b"\3CSI\7"),
        SECOND.replace(b"\0\x21\x45", b"\0\x22\x45"),
        SECOND.replace(b"\xf2\0\1\2", b"\xf2\0\2\2"),
        SECOND.replace(b"\xf2\0\1\2", b"\xf2\0\0\2"),
        SECOND.replace(b"\x09ExtraInfo", b"\xf9ExtraInfo"),
    ],
    ids=["header", "version", "device", "streams", "no streams", "segment"],
)
def test_a_broken_frame_costs_itself(opened: Open, broken: bytes) -> None:
    assert broken != SECOND
    capture = opened(AX210 + broken + AX210)
    assert len(capture.group) == 8
    assert dict(capture.log.left_out) == {"broken record": 1}


def test_a_cut_frame_costs_itself(opened: Open) -> None:
    capture = opened(AX210[:-5])
    assert (len(capture.group), dict(capture.log.left_out)) == (3, {"cut short": 1})


def test_frames_of_other_shapes_are_other_kinds(opened: Open) -> None:
    capture = opened(AX210 + WRITTEN["ax200"][: len(WRITTEN["ax200"]) // 2])
    assert len(capture.group) == 4
    other = capture.log.groups[1].kind
    assert other.differs_in(capture.group.kind, capture.log.order) == "other shape"


def test_frames_without_csi_alone(opened: Open) -> None:
    with pytest.raises(SetupError, match="no CSI frames"):
        opened(SECOND.replace(b"\3CSI", b"\3CSX"))


def test_many_arrangements_of_segments(opened: Open) -> None:
    frames = [
        picoscenes(CSI["ax210"][:1], basic_version=1 + n % 5, csi_version=3 + n % 4) for n in range(200)
    ]
    capture = opened(b"".join(frames))
    assert sum(map(len, capture.log.groups)) == 200
