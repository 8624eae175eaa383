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
from chachart.sources.formats.tfexample import read_example
from chachart.sources.formats.tfrecord import masked_crc


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


@pytest.mark.parametrize(("records", "more"), [(2, 20), (3, 5)])
def test_a_cut_record_costs_itself(path: Path, records: int, more: int) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: records * len(whole) // 4 + more])
    capture = open_capture(path)
    np.testing.assert_array_equal(frames(capture.read("csi"), (*capture.axes, "iq")), CSI[:records])
    assert dict(capture.left_out) == {"cut short": 1}


def test_what_is_wrong_is_told_with_its_record(path: Path) -> None:
    whole = path.read_bytes()
    step = len(whole) // 4
    path.write_bytes(whole[:20])
    with pytest.raises(SetupError, match="ends within record 0"):
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


def test_the_checksum_is_masked_as_the_format_has_it() -> None:
    crc = 0xE3069283  # CRC-32C of these digits
    assert masked_crc(b"123456789") == ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


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
