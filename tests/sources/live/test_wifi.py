"""The source `wifi`: each tool simulated at the other end of its own way."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_node import free_port
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.security import SecuritySettings
from chachart.sources.formats.wifi import tones
from chachart.sources.live.device import CodecError
from chachart.sources.live.wifi import openwifi
from chachart.sources.live.wifi.cutting import LengthFirst, Lines, PcapStream, PicoScenesForwarder
from chachart.sources.live.wifi.encoding import ENCODERS, Packet
from chachart.sources.live.wifi.simulated import RSSI_DBM, SimulatedTool
from chachart.sources.live.wifi.source import WifiLoopback, WifiSettings, WifiSource
from chachart.sources.live.wifi.tools import decoder
from chachart.sources.simulator import Simulator, SimulatorSettings

HT = tones.carrying("ht", 20)
ARRAYS: dict[str, tuple[int, tuple[int, ...]]] = {
    "nexmon": (4, tuple(n for n in HT if n not in (28, 29, 30))),
    "nexmon_pcap": (2, tuple(n for n in HT if n not in (28, 29, 30))),
    "picoscenes": (2, tuple(range(-32, 32))),
    "feitcsi": (2, HT),
    "intel5300": (3, tones.intel5300(20).numbers or ()),
    "esp32": (1, tones.carrying("legacy", 20)),
    "openwifi": (1, HT),
}


def array(tool: str) -> ArrayGeometry:
    antennas, numbers = ARRAYS[tool]
    return ArrayGeometry("wifi", antennas, len(numbers), 5.18e9, 312_500.0, 0.029, tones=numbers)


def scenario(**changes: Any) -> SimulatorSettings:
    return SimulatorSettings.model_validate({"ues": 8, "frame_rate_hz": 400.0, "snr_db": 200.0, **changes})


class TestContract(SourceContract):
    @pytest.fixture(params=["nexmon", "intel5300", "esp32"])
    def case(self, request: pytest.FixtureRequest) -> SourceCase:
        loopback = {"scenario": {"ues": 8, "frame_rate_hz": 500.0, "snr_db": 20.0}}
        return SourceCase("wifi", {"tool": request.param, "loopback": loopback}, array(request.param))


@pytest.mark.parametrize("tool", ARRAYS)
def test_frames_are_what_was_heard_to_the_tools_precision(tool: str) -> None:
    loopback = WifiLoopback(scenario=scenario(frames=60))
    with WifiSource(WifiSettings(tool=tool, loopback=loopback), array(tool)) as source:
        blocks = receive(source, 10_000)
        rejected = source.rejected.as_dict()
    assert rejected == {}
    with Simulator(scenario(frame_rate_hz=0.0, frames=8), array(tool)) as simulator:
        block = simulator.recv(10.0)
        assert block is not None
    csi = np.concatenate([b.csi for b in blocks]).reshape(60, -1)
    ues = np.concatenate([b.ue for b in blocks]).astype(int)
    if tool == "openwifi":  # says neither who sent nor at which power
        ues = np.arange(60) % 8
    truth = block.csi.reshape(8, -1)[ues]
    likeness = np.abs(np.sum(csi * truth.conj(), axis=1))
    likeness /= np.linalg.norm(csi, axis=1) * np.linalg.norm(truth, axis=1)
    assert likeness.min() > (0.9999 if tool in ("intel5300", "esp32") else 0.999999)
    if tool != "openwifi":
        power = 10 * np.log10(np.mean(np.abs(csi) ** 2, axis=1))
        expected = RSSI_DBM + 10 * np.log10(np.mean(np.abs(truth) ** 2, axis=1))
        np.testing.assert_allclose(power, expected, atol=1.1)  # whole dB


@pytest.mark.parametrize("tool", ARRAYS)
def test_what_is_lost_or_damaged_is_counted_exactly(tool: str) -> None:
    loopback = WifiLoopback(
        scenario=scenario(frames=600, frame_rate_hz=600.0), drop=0.05, corrupt=0.05, reorder=0.1
    )
    with WifiSource(WifiSettings(tool=tool, loopback=loopback), array(tool)) as source:
        blocks = receive(source, 10_000)
        assert isinstance(source.simulated, SimulatedTool)
        report, rejected = source.simulated.report, source.rejected.as_dict()
    assert report.sent + report.dropped + report.corrupted == 600
    assert min(report.dropped, report.corrupted) > 10
    assert report.reordered > 10 or tool in ("nexmon_pcap", "intel5300", "esp32")  # streams
    assert sum(len(b) for b in blocks) == report.sent
    if tool == "nexmon":  # the other cores of the frame, or what there are of them
        assert rejected.pop("incomplete", 0) + rejected.pop("other_antennas", 0) == report.corrupted
    assert sum(rejected.values()) == report.corrupted


def test_frames_of_other_shapes_are_told_by_reason() -> None:
    source = WifiSource(WifiSettings(tool="esp32", loopback=True), array("feitcsi"))
    with pytest.raises(SetupError, match="esp32 measures 1 x 64"):
        source.open()
    rejected = Counters()
    settings = WifiSettings(tool="nexmon", port=free_port())
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        WifiSource(settings, array("nexmon")) as source,
    ):
        one = Packet(0, 5, 1000, -50, np.full((1, 64), 100.0 + 0j))
        for piece in (b"noise", *ENCODERS["nexmon"](one)):
            sender.sendto(piece, ("127.0.0.1", settings.port))
        for _ in range(50):
            assert source.recv(0.1) is None
            rejected = source.rejected
            if len(rejected.as_dict()) == 2:
                break
    assert rejected.as_dict() == {"datagram": 1, "other_antennas": 1}


def test_an_address_that_others_reach_is_a_mistake() -> None:
    settings = WifiSettings(tool="picoscenes", listen="192.0.2.7")
    [told] = settings.exposure(SecuritySettings())
    assert '"udp://192.0.2.7:50000"' in told
    assert settings.exposure(SecuritySettings(without_keys=("udp://192.0.2.7:50000",))) == []
    assert WifiSettings(tool="esp32", listen="192.0.2.7").exposure(SecuritySettings()) == []


@pytest.mark.parametrize("tool", ARRAYS)
@given(pieces=st.lists(st.binary(max_size=120), max_size=6))
def test_any_bytes_are_frames_or_a_reason(tool: Any, pieces: list[bytes]) -> None:
    decode = decoder(tool, "integers", 8, Counters())
    with suppress(CodecError):
        for piece in [*pieces, b""]:
            for log in decode.feed([piece] if piece else []):
                assert log.frames >= 0


@given(
    st.lists(st.tuples(st.sampled_from([0xBB, 0xC1, 0x01]), st.binary(max_size=30)), max_size=6),
    st.integers(1, 20),
)
def test_records_with_their_length_first_are_cut_where_they_end(
    records: list[tuple[int, bytes]], size: int
) -> None:
    wire = b"".join(struct.pack(">HB", len(body) + 1, code) + body for code, body in records)
    cutter = LengthFirst()
    got = b"".join(cutter.feed(wire[at : at + size]) for at in range(0, len(wire), size))
    while records and records[-1][0] == 0xC1:  # waits for the CSI that follows
        records = records[:-1]
    assert got == b"".join(struct.pack(">HB", len(body) + 1, code) + body for code, body in records)


@given(st.lists(st.binary(max_size=30).map(lambda b: b.replace(b"\n", b".")), max_size=6), st.integers(1, 20))
def test_lines_are_cut_where_they_end(lines: list[bytes], size: int) -> None:
    wire = b"".join(line + b"\n" for line in lines if not line.startswith(b"type,"))
    cutter = Lines()
    assert b"".join(cutter.feed(wire[at : at + size]) for at in range(0, len(wire), size)) == wire


def test_a_heading_stands_before_later_lines_too() -> None:
    cutter = Lines()
    assert cutter.feed(b"boot\ntype,a,b\nfirst\nsec") == b"boot\ntype,a,b\nfirst\n"
    assert cutter.feed(b"ond\n") == b"type,a,b\nsecond\n"


def test_a_stream_that_is_no_pcap_is_told() -> None:
    with pytest.raises(ValueError, match="pcap"):
        PcapStream().feed(b"GET / HTTP/1.1\r\n" * 3)


@given(st.binary(min_size=1, max_size=500), st.integers(20, 200), st.randoms())
def test_parts_of_a_forwarded_frame_are_joined(frame: bytes, longest: int, random: Any) -> None:
    rejected = Counters()
    parts = PicoScenesForwarder.encode(frame, 7, longest)
    random.shuffle(parts)
    forwarder = PicoScenesForwarder(rejected)
    assert b"".join(forwarder.feed(part) for part in parts) == frame
    assert rejected.as_dict() == {}


@given(st.integers(0, 2**60), st.integers(0, 2**32 - 1))
def test_a_record_of_openwifi_comes_back(time_us: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    csi = np.round(rng.uniform(-30_000, 30_000, (56, 2))) @ [1, 1j]
    log = openwifi.read(np.frombuffer(openwifi.encode(csi.astype(np.complex64), time_us), np.uint8))
    np.testing.assert_array_equal(log.groups[0].csi.ravel(), csi)
    assert log.groups[0].kind.tones.numbers == (*range(-28, 0), *range(1, 29))
