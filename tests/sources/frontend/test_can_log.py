from pathlib import Path

import can
import numpy as np
import pytest
from front_ends import ARRAY, assert_same_chart, direct, listen, origin, scenario
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from source_contract import SourceCase, SourceContract

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.base import EndOfSource
from chachart.sources.frontend.can import CanSettings, CanSource
from chachart.sources.frontend.can_files import _are_differences
from chachart.sources.frontend.can_log import CanLog, CanLogSettings
from chachart.sources.frontend.packet import Heartbeat, encode


def record(path: Path, frames: int, **loopback) -> Path:
    """What a logger on the bus writes while a node listens to a simulated front-end."""
    bus = CanSettings(
        interface="virtual", channel=str(path), loopback={"scenario": scenario(frames), **loopback}
    )
    logger = can.Bus(str(path), "virtual", ignore_config=True)
    with can.Logger(path) as write:
        with CanSource(bus, ARRAY) as source:
            listen(source, frames)
        while (message := logger.recv(0.0)) is not None:
            write(message)
    logger.shutdown()
    return path


def drain(source: CanLog) -> list[CsiBlock]:
    """All blocks of an open source."""
    blocks = []
    while True:
        try:
            block = source.recv(1.0)
        except EndOfSource:
            return blocks
        if block is not None:
            blocks.append(block)


def replay(path: Path) -> tuple[CanLog, CsiBlock]:
    with CanLog(CanLogSettings(path=path, speed=0.0), ARRAY) as source:
        return source, CsiBlock.concatenate(drain(source))


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("log") / "bus.log", 20)


class TestContract(SourceContract):
    @pytest.fixture
    def case(self, log) -> SourceCase:
        return SourceCase("can_log", {"path": log, "speed": 0.0}, ARRAY)


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_a_logged_bus_replays_to_the_same_chart(tmp_path, suffix):
    source, got = replay(record(tmp_path / f"bus{suffix}", 300))
    assert_same_chart(got, direct(300))
    assert source.details()["front_ends"]["0x640"]["lost"] == 0
    assert source.rejected.as_dict() == {}
    assert (np.diff(got.time_ns) >= 0).all()
    assert 1.6e18 < got.time_ns[0] < 9e18


def test_what_was_damaged_on_the_bus_is_counted_again(tmp_path):
    source, got = replay(record(tmp_path / "bus.blf", 400, corrupt=0.05, drop=0.05))
    assert len(origin(got, direct(400))) == len(got) < 400
    assert source.details()["front_ends"]["0x640"]["lost"] == 400 - len(got)


def test_it_plays_at_the_recorded_pace(tmp_path):
    path = tmp_path / "bus.log"
    with can.Logger(path) as write:
        for n in range(5):
            single = b"\0\x14" + encode(Heartbeat(0, n)) + b"\xcc\xcc"
            write(can.Message(1e9 + 10 * n, 0x640, data=single, is_fd=True, is_extended_id=False))
    with CanLog(CanLogSettings(path=path, speed=100.0), ARRAY) as source:
        assert source.recv(0.0) is None
        assert source.details()["played_s"] == 0.0
        assert drain(source) == []
        assert source.details()["played_s"] == 40.0
        assert source.rejected.as_dict() == {}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("bus.csv", b"", "must end in .blf, .asc, .log"),
        ("bus.blf", b"no such thing, but long enough for a header" * 9, "is no .blf log"),
        ("bus.blf", b"", "is no .blf log"),
        ("bus.log", b"", "holds no CAN message"),
        ("bus.log", b"noise\n", "is no .log log"),
        ("bus.asc", b"", "holds no CAN message"),
    ],
)
def test_a_file_that_is_no_log_is_said_so(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SetupError, match=said):
        CanLog(CanLogSettings(path=tmp_path / name), ARRAY).open()


def test_a_file_that_is_missing_is_said_so(tmp_path):
    with pytest.raises(SetupError, match="there is no such file"):
        CanLog(CanLogSettings(path=tmp_path / "none.blf"), ARRAY).open()


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_damaged_lines_are_counted_and_passed_over(tmp_path, suffix):
    path = record(tmp_path / f"bus{suffix}", 300)
    lines = path.read_text().splitlines()
    places = [len(lines) // 4, len(lines) // 2]
    for at in places:
        lines[at] = lines[at].replace("640", "64x")
    path.write_text("\n".join(lines) + "\n")
    source, got = replay(path)
    assert 300 - 2 * len(places) <= len(got) < 300
    assert len(origin(got, direct(300))) == len(got)
    if suffix == ".log":
        assert source.rejected.as_dict()["damaged_line"] == 2


def test_a_damaged_object_of_a_binary_log_costs_what_it_held(tmp_path):
    path = record(tmp_path / "bus.blf", 400)
    raw = bytearray(path.read_bytes())
    second = raw.index(b"LOBJ", raw.index(b"LOBJ") + 4)
    raw[second : second + 4] = b"JBOL"
    path.write_bytes(raw)
    source, got = replay(path)
    assert 0 < len(got) < 400
    assert source.rejected.as_dict()["damaged_object"] >= 1


def on_buses(path: Path, frames: int, names: tuple[str, ...]) -> Path:
    """The same front-end on several buses, its messages taking turns."""
    lines = record(path, frames).read_text().splitlines()
    first = lines[0].split()[1]
    path.write_text("\n".join(line.replace(f" {first} ", f" {n} ") for line in lines for n in names) + "\n")
    return path


def test_one_identifier_on_several_buses(tmp_path):
    path = on_buses(tmp_path / "bus.log", 300, ("can0", "can1"))
    source, got = replay(path)
    assert len(got) == 600
    assert set(source.details()["front_ends"]) == {"0x640", "0x640@can1"}
    with CanLog(CanLogSettings(path=path, speed=0.0, channel="can1"), ARRAY) as alone:
        assert_same_chart(CsiBlock.concatenate(drain(alone)), direct(300))
    with pytest.raises(SetupError, match="holds no CAN message on channel can7"):
        CanLog(CanLogSettings(path=path, channel="can7"), ARRAY).open()


def test_stamps_that_are_relative_to_the_one_before(tmp_path):
    path = record(tmp_path / "bus.asc", 40)
    _, absolute = replay(path)
    lines, before = [], 0.0
    for line in path.read_text().splitlines():
        line = line.replace("timestamps absolute", "timestamps relative")
        word = line.split()[0] if line.split() else ""
        if word.replace(".", "").isdigit() and "." in word:
            line = line.replace(word, f"{float(word) - before:.6f}", 1)
            before = float(word)
        lines.append(line)
    assert any("timestamps relative" in line for line in lines)
    path.write_text("\n".join(lines) + "\n")
    _, relative = replay(path)
    np.testing.assert_allclose(relative.time_ns, absolute.time_ns, atol=50_000)


@pytest.mark.parametrize("zero_based", [True, False])
def test_stamps_of_candump_that_begin_at_zero_or_are_differences(tmp_path, zero_based):
    path = record(tmp_path / "bus.log", 40)
    _, absolute = replay(path)
    lines = path.read_text().splitlines()
    first = before = float(lines[0].split(")")[0].strip("( "))
    for n, line in enumerate(lines):
        head, _, rest = line.partition(")")
        stamp = float(head.strip("( "))
        lines[n] = f"({stamp - (first if zero_based else before):017.6f}){rest}"
        before = stamp
    path.write_text("\n".join(lines) + "\n")
    _, told = replay(path)
    np.testing.assert_allclose(np.diff(told.time_ns), np.diff(absolute.time_ns), atol=50_000)


@pytest.mark.parametrize(
    ("stamps", "differences"),
    [
        ([0.0, 0.001, 0.001, 0.001, 0.001, 0.001], True),
        ([0.0, 0.003, 0.001, 0.002, 0.001, 0.004], True),
        ([0.0, 0.001, 0.002, 0.003, 0.004, 0.005], False),
        ([1.6e9, 1.6e9, 1.6e9, 1.6e9], False),
        ([0.0, 0.5], False),
    ],
)
def test_which_stamps_are_differences(stamps, differences):
    assert _are_differences(f"({stamp:017.6f}) can0 123#00" for stamp in stamps) == differences


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("good")
    return {s: record(folder / f"bus{s}", 5).read_bytes() for s in (".blf", ".asc", ".log")}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(suffix=st.sampled_from([".blf", ".asc", ".log"]), data=st.data())
def test_any_damage_to_a_log_gives_an_error_or_the_rest(tmp_path, good, suffix, data):
    raw = bytearray(good[suffix])
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / f"bus{suffix}"
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    source = CanLog(CanLogSettings(path=path, speed=0.0), ARRAY)
    try:
        source.open()
    except SetupError:
        return
    blocks = drain(source)
    source.close()
    assert sum(len(b) for b in blocks) <= 5
