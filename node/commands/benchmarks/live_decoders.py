"""Decoders of live devices alone: time from what a device sends to frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from chachart.node.commands.benchmarks.live_devices import WIFI, devices
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import time_in_turn
from chachart.node.data.counters import Counters
from chachart.sources.live.espargos.cluster import Grouping
from chachart.sources.live.espargos.message import SensorCsi, decode_message, encode_message
from chachart.sources.live.espargos.stream import Fragment, Reassembly, decode_packet, encode_packet
from chachart.sources.live.krakensdr.bursts import bursts, factor
from chachart.sources.live.krakensdr.heimdall import HEADER_BYTES, decode_header, decode_samples
from chachart.sources.live.krakensdr.receiver import KrakenFaults, SimulatedKraken
from chachart.sources.live.krakensdr.source import KrakenSettings
from chachart.sources.live.oai.gnb import ESTIMATE, ESTIMATE_EVENT, GnbFaults, SimulatedGnb
from chachart.sources.live.oai.srs import Soundings, estimate, used
from chachart.sources.live.oai.tracer import EventStream, decode_arguments
from chachart.sources.live.wifi.cutting import PicoScenesForwarder
from chachart.sources.live.wifi.encoding import ENCODERS, FULL_SCALE, SUBCARRIERS, Packet
from chachart.sources.live.wifi.frames import Selection
from chachart.sources.live.wifi.simulated import LARGEST_PART
from chachart.sources.live.wifi.tools import decoder
from chachart.sources.simulator import Simulator, SimulatorSettings

PACKETS = 256


def decoders() -> Table:
    """Time from what a device sends to frames, one thread, no socket."""
    table = Table(
        f"decoders of live devices alone, {PACKETS} frames", ["device", "frame", "us a frame", "frames/s"]
    )
    calls = {f"wifi {tool}": _wifi(tool) for tool in WIFI}
    calls |= {"espargos": _espargos(), "oai": _oai(), "krakensdr": _krakensdr()}
    for name, timing in time_in_turn(calls).items():
        array, each = devices()[name].array, timing.scaled(1 / PACKETS)
        table.add(name, f"{array.antennas} x {array.subcarriers}", each.scaled(1e6), 1 / each.median)
    return table


def _wifi(tool: str) -> Callable[[], None]:
    """Decode packets of a tool; what does not come out is a mistake."""
    array = devices()[f"wifi {tool}"].array
    rng = np.random.default_rng(1)
    scale, count = FULL_SCALE.get(tool, 1000.0), SUBCARRIERS.get(tool, 64)
    pieces: list[bytes] = []
    for n in range(PACKETS):
        csi = scale * np.exp(2j * np.pi * rng.random((array.antennas, count)))
        made = ENCODERS[tool](Packet(n, 1 + n % 8, 1000 * n, -50, csi))
        pieces += made if tool != "picoscenes" else PicoScenesForwarder.encode(made[0], n, LARGEST_PART)

    def decode() -> None:
        rejected = Counters()
        decoding = decoder(tool, "integers", 8, rejected)  # type: ignore[arg-type]
        selection = Selection(array, "auto", rejected)
        logs = [log for at in range(0, len(pieces), 16) for log in decoding.feed(pieces[at : at + 16])]
        found = sum(len(selection.frames(log, 1)) for log in [*logs, *decoding.feed([])])
        _expect(found, tool, rejected)

    return decode


def _espargos() -> Callable[[], None]:
    """Decode datagrams of a board, one a sensor and packet."""
    array = devices()["espargos"].array
    rng = np.random.default_rng(1)
    packets: list[bytes] = []
    for n in range(PACKETS):
        csi = (1000 * np.exp(2j * np.pi * rng.random((array.antennas, array.subcarriers)))).astype(
            np.complex64
        )
        for antenna, row in enumerate(csi):
            said = SensorCsi(1 + n % 8, 2, n, False, False, 50_000 * n, row, -50, -90, 6, 0)
            packets.append(encode_packet([Fragment(antenna << 29 | n + 1, 0, 1, encode_message(said))]))

    def decode() -> None:
        rejected = Counters()
        reassembly, grouping = Reassembly(rejected), Grouping(array.antennas, rejected)
        found = 0
        for packet in packets:
            for fragment in decode_packet(packet):
                whole = reassembly.add(fragment, 0.0)
                sensor = None if whole is None else decode_message(whole)
                cluster = None if sensor is None else grouping.add(fragment.antenna, sensor, 0.0)
                found += cluster is not None and len(cluster.aligned()) == array.antennas
        _expect(found, "espargos", rejected)

    return decode


def _oai() -> Callable[[], None]:
    """Decode a tracer's events, one an antenna and sounding."""
    array = devices()["oai"].array
    gnb = SimulatedGnb(Simulator(SimulatorSettings(), array), 1, GnbFaults())
    rng = np.random.default_rng(1)
    shape = array.antennas, array.subcarriers
    stream = b"".join(
        gnb.sounding(1 + n % 8, 1000 * n, np.exp(2j * np.pi * rng.random(shape)).astype(np.complex64))
        for n in range(PACKETS)
    )
    gnb.stop()

    def decode() -> None:
        rejected = Counters()
        soundings, found = Soundings(array.antennas, rejected), 0
        for event in EventStream().feed(stream):
            if event.type == ESTIMATE_EVENT:
                heard = estimate(decode_arguments(ESTIMATE, event.body), 1)
                found += soundings.add(heard, used(heard.tones, 1, array.subcarriers)) is not None
        _expect(found, "oai", rejected)

    return decode


def _krakensdr() -> Callable[[], None]:
    """Decode acquisitions of 4096 samples and channelise them: a frame a transmitter."""
    array = devices()["krakensdr"].array
    receiver = SimulatedKraken(array, KrakenFaults(samples=4096, rate_hz=1_000_000))
    acquisitions = [receiver.acquisition() for _ in range(PACKETS // 2)]
    receiver.stop()
    settings = KrakenSettings()

    def decode() -> None:
        found = 0
        for data in acquisitions:
            header = decode_header(data[:HEADER_BYTES])
            samples = decode_samples(header, data[HEADER_BYTES:])
            heard = bursts(
                samples, header.centre_hz, header.rate_hz, settings.channel_width_hz, settings.squelch_db
            )
            found += len([factor(burst.covariance, array.subcarriers) for burst in heard])
        _expect(found, "krakensdr", Counters())

    return decode


def _expect(found: int, device: str, rejected: Counters) -> None:
    if found != PACKETS:
        raise AssertionError(f"{found} of {PACKETS} frames of {device} came out: {rejected.as_dict()}")
