from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from picoscenes_captures import SYSTEM_NS, picoscenes

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import frames
from chachart.sources.formats.base import Capture


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


def assert_holds(capture: Capture, csi: np.ndarray) -> None:
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
    np.testing.assert_array_equal(capture.read("timestamp"), 1000 + 5000 * np.arange(4))
    np.testing.assert_array_equal(capture.read("ue"), 0x0200_0000_0000 + np.arange(4))
    assert ("time" in capture.variables) == (version >= 4)
    if version >= 4:
        np.testing.assert_array_equal(capture.read("time"), SYSTEM_NS + 5_000_000 * np.arange(4))


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


@pytest.mark.parametrize("device", ["5300", "9300"])
def test_csiread_reads_the_same(tmp_path: Path, device: str) -> None:
    csiread = pytest.importorskip("csiread")
    path = tmp_path / "capture.csi"
    csi = CSI[device]
    path.write_bytes(picoscenes(csi, device, csi_version=4, basic_version=3, frame_version=1))
    log = csiread.Picoscenes(str(path), {"CSI": list(csi.shape[1:])}, if_report=False)
    log.read()
    with_csi = [0, 2, 3, 4]
    np.testing.assert_array_equal(log.raw["CSI"]["CSI"][with_csi], csi)
    np.testing.assert_array_equal(log.raw["RxSBasic"]["Timestamp"][with_csi], 1000 + 5000 * np.arange(4))


AX210 = WRITTEN["ax210"]
SECOND = picoscenes(CSI["ax210"][:1])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (AX210[:-5], "ends within frame 4"),
        (AX210 + b"xy", "ends within frame 5"),
        (AX210 + bytes(8), "frame 5: it has 4 bytes"),
        (AX210 + SECOND[:4] + b"x" + SECOND[5:], "frame 5: its header is not"),
        (AX210 + SECOND.replace(b"RxSBasic", b"RxSBasis"), "frame 5: its RxSBasic segment"),
        (AX210 + SECOND.replace(b"\3CSI\6", b"\3CSI\7"), "frame 5: version 7 of the CSI segment"),
        (AX210 + SECOND.replace(b"\0\x21\x45", b"\0\x22\x45"), "frame 5: the CSI of device 0x2200"),
        (AX210 + SECOND.replace(b"\xf2\0\1\2", b"\xf2\0\2\2"), r"frame 5: .* do not fit \(242, 2, 2\)"),
        (AX210 + SECOND.replace(b"\xf2\0\1\2", b"\xf2\0\0\2"), "frame 5: .* bytes of CSI for"),
        (AX210 + SECOND.replace(b"\x09ExtraInfo", b"\xf9ExtraInfo"), "frame 5: the lengths in its segment 1"),
        (AX210 + WRITTEN["ax200"], r"frame 5 has .* \(56, 2, 2\), the first has \(242, 2, 1\)"),
        (SECOND.replace(b"\3CSI", b"\3CSX"), "no CSI frames"),
    ],
)
def test_what_is_wrong_is_told(opened: Open, data: bytes, words: str) -> None:
    with pytest.raises(SetupError, match=words):
        opened(data)


@pytest.mark.parametrize("device", WRITTEN)
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_captures_give_an_error_or_arrays(opened: Open, device: str, data: st.DataObject) -> None:
    damaged = bytearray(WRITTEN[device])
    if data.draw(st.booleans(), "cut"):
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
