from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from capture_files import CSI, POSITION, dichasus, example, field, record, tensor
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture
from chachart.sources.formats.arrange import frames
from chachart.sources.formats.crc32c import crc32c
from chachart.sources.formats.tfexample import read_example


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "capture.dat"
    file.write_bytes(dichasus(CSI, POSITION))
    return file


def test_a_dichasus_file(path: Path) -> None:
    capture = open_capture(path)
    assert {name: v.shape for name, v in capture.variables.items()} == {
        "csi": (4, 3, 2, 2),
        "pos-tachy": (4, 3),
        "time": (4,),
        "counter": (4,),
    }
    csi = frames(capture.read("csi"), ["ue", "antenna", "subcarrier", "iq"])
    np.testing.assert_array_equal(csi, CSI)
    np.testing.assert_array_equal(capture.read("pos-tachy"), POSITION)
    assert capture.read("time").tolist() == [0.0, 0.5, 1.0, 1.5]
    assert capture.read("counter").tolist() == [1000, 1001, 1002, 1003]


def test_what_is_wrong_is_told_with_its_record(path: Path) -> None:
    whole = path.read_bytes()
    step = len(whole) // 4
    path.write_bytes(whole[: 2 * step + 20])
    with pytest.raises(SetupError, match="ends within record 2"):
        open_capture(path)
    path.write_bytes(whole[: 3 * step + 5])
    with pytest.raises(SetupError, match="ends within record 3"):
        open_capture(path)
    damaged = bytearray(whole)
    damaged[step + 40] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(SetupError, match="record 1 has another checksum"):
        open_capture(path).read("csi")
    damaged = bytearray(whole)
    damaged[step + 1] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(SetupError, match="length of record 1 has another checksum"):
        open_capture(path)


def test_records_that_differ(path: Path) -> None:
    path.write_bytes(dichasus(CSI, POSITION) + dichasus(CSI[:1, :2], POSITION[:1]))
    with pytest.raises(SetupError, match=r'record 4 has float32 \(2, 2, 2\) as "csi", unlike the first'):
        open_capture(path).read("csi")
    path.write_bytes(dichasus(CSI, POSITION) + record(example({})))
    with pytest.raises(SetupError, match='record 4 has no "csi"'):
        open_capture(path).read("csi")


def test_lists_and_bytes_that_are_no_tensor() -> None:
    floats = np.array([1.5, -2.0], "<f4").tobytes()
    message = example(
        {
            "floats": field(2, field(1, floats)),
            "negative": field(3, field(1, b"\xff" * 9 + b"\x01")),
            "name": field(1, field(1, b"lab")),
        }
    )
    features = read_example(memoryview(message))
    assert features["floats"].tolist() == [1.5, -2.0]
    assert features["negative"] == -1
    assert features["name"] == b"lab"


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        (b"123456789", 0xE3069283),
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (b"", 0),
        (b"a", 0xC1D04330),
    ],
)
def test_crc32c_of_known_strings(data: bytes, crc: int) -> None:
    assert crc32c(data) == crc


def bit_by_bit(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


@pytest.mark.parametrize("length", [0, 1, 2047, 2048, 2049, 2176, 4096, 4097, 20_000])
def test_crc32c_of_any_length_is_that_of_the_definition(length: int) -> None:
    data = np.random.default_rng(length).bytes(length)
    assert crc32c(data) == bit_by_bit(data)


@given(st.binary(min_size=1, max_size=300), st.integers(1, 12), st.data())
def test_crc32c_sees_every_flip(data: bytes, times: int, draw: st.DataObject) -> None:
    data *= times
    flipped = bytearray(data)
    flipped[draw.draw(st.integers(0, len(data) - 1))] ^= draw.draw(st.integers(1, 255))
    assert crc32c(bytes(flipped)) != crc32c(data)


@given(st.binary(max_size=200) | st.builds(lambda n: tensor(np.zeros(n, np.float32)), st.integers(0, 9)))
def test_any_bytes_are_an_example_or_an_error(data: bytes) -> None:
    try:
        features = read_example(memoryview(data))
    except ValueError as error:
        event(str(error)[:12])
    else:
        assert all(isinstance(value, np.ndarray) for value in features.values())


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files(path: Path, data: st.DataObject) -> None:
    damaged = bytearray(dichasus(CSI, POSITION))
    del damaged[data.draw(st.integers(0, len(damaged))) :]
    for _ in range(data.draw(st.integers(0, 2)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(damaged)
    try:
        capture = open_capture(path)
        for name in capture.variables:
            capture.read(name)
    except SetupError as error:
        event(str(error).rpartition(":")[2])
