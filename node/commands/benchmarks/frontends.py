"""Front-ends: the packet decoders alone, whole links between two processes, and what damage costs."""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import live_decoders, live_devices
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import Timing, time_in_turn
from chachart.node.commands.shared.cli import progress
from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source
from chachart.sources.frontend import packet
from chachart.sources.frontend.address import FrontEndAddress
from chachart.sources.frontend.can import MAX_MESSAGES, CanSettings, CanSource
from chachart.sources.frontend.packet import CsiPacket, SampleFormat
from chachart.sources.frontend.serial import SerialSettings, SerialSource
from chachart.sources.frontend.session import Intake

GROUP = "239.74.163.2"
BLOCK = 64
GIVE_UP_S = 60.0
"""A link on which nothing comes for so long is broken."""


@dataclass(frozen=True, slots=True)
class Passage:
    """How frames got through a link: `cpu` seconds of this process, `told` the front-end's own report."""

    arrived: int
    lost: int
    seconds: float
    cpu: float
    told: dict[str, int]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench frontends`."""
    parser.add_argument("--frames", type=int, default=10_000, help="over serial (default: %(default)s)")
    parser.add_argument("--can-frames", type=int, default=2_000, help="over CAN (default: %(default)s)")
    parser.add_argument(
        "--device-frames", type=int, default=10_000, help="of each live device (default: %(default)s)"
    )
    parser.add_argument("--antennas", type=int, default=32, help="default: %(default)s")
    parser.add_argument("--subcarriers", type=int, default=32, help="default: %(default)s")
    parser.add_argument("--can-antennas", type=int, default=8, help="default: %(default)s")
    parser.add_argument("--can-subcarriers", type=int, default=16, help="default: %(default)s")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure decoders and links.

    Raises
    ------
    SetupError
        If a library is missing.
    """
    require("serial", "chachart bench frontends:")
    require("can", "chachart bench frontends:")
    large = ArraySettings(antennas=arguments.antennas, subcarriers=arguments.subcarriers).geometry()
    small = ArraySettings(antennas=arguments.can_antennas, subcarriers=arguments.can_subcarriers).geometry()
    with progress("measuring", 7) as done:
        alone = decoders(large)
        done(1)
        links = Table(
            "links, whole: simulated front-end to blocks of CSI",
            ["link", "frame", "frames", "lost", "frames/s", "MB/s", "CPU us a frame"],
        )
        faults = Table(
            "the same with bytes flipped, lost or inserted in 1 % of the frames and 1 % never sent",
            ["link", "sent whole", "arrived", "damaged + not sent", "counted as lost"],
        )
        links.notes.append("CPU: of the receiving process, which is the sending one too on the virtual bus")
        faulty = ("--corrupt", "0.01", "--drop", "0.01")
        for name, link, array, frames in (
            ("serial (pty, two processes)", over_serial, large, arguments.frames),
            ("CAN FD (virtual, one process)", over_virtual, small, arguments.can_frames),
            ("CAN FD (UDP multicast, two processes)", over_multicast, small, arguments.can_frames),
        ):
            shape = f"{array.antennas} x {array.subcarriers} int16"
            try:
                whole = link(array, frames, ())
                size = _frame_bytes(array) * whole.arrived / whole.seconds / 1e6
                rate = whole.arrived / whole.seconds
                links.add(name, shape, whole.arrived, whole.lost, rate, size, whole.cpu / whole.arrived * 1e6)
                done(1)
                hit = link(array, frames, faulty)
                spoiled = hit.told["corrupted"] + hit.told["dropped"]
                faults.add(name, hit.told["sent"], hit.arrived, spoiled, hit.lost)
            except (SetupError, OSError) as error:
                links.notes.append(f"{name}: not measured: {error}")
            done(1)
    return [alone, links, faults, live_decoders.decoders(), *live_devices.tables(arguments.device_frames)]


def decoders(array: ArrayGeometry) -> Table:
    """Time from bytes to CSI blocks of 64 frames, one thread, no port."""
    from chachart.sources.frontend.framing import StreamDecoder, encode_frame

    table = Table(
        f"decoders alone, {array.antennas} x {array.subcarriers}, blocks of {BLOCK} frames",
        ["bytes to CSI", "us a frame", "frames/s", "MB/s"],
    )
    rng = np.random.default_rng(1)
    pairs = rng.standard_normal((BLOCK, array.antennas, array.subcarriers, 2), np.float32)
    csi = pairs.view(np.complex64)[..., 0]
    for fmt in SampleFormat:
        raw = [packet.encode(CsiPacket.quantise(n, n + 1, n, csi[n], fmt)) for n in range(BLOCK)]
        limit = len(raw[0])

        def packets(raw: list[bytes] = raw) -> None:
            intake = Intake(array, Counters())
            for one in raw:
                intake.receive("a", one, 1)
            intake.take()

        def serial(stream: bytes = b"".join(map(encode_frame, raw)), limit: int = limit) -> None:
            intake, decoder = Intake(array, Counters()), StreamDecoder(limit, Counters())
            for start in range(0, len(stream), 4096):
                for one in decoder.feed(stream[start : start + 4096]):
                    intake.receive("a", one, 1)
            intake.take()

        calls: dict[str, Callable[[], Any]] = {"packet": packets, "serial": serial}
        if fmt is SampleFormat.INT16:
            calls["CAN FD"] = _can_decoder(array, raw)
        for name, timing in time_in_turn(calls).items():
            _add_rate(table, f"{name}, {fmt.name.lower()}", timing, limit)
    return table


def over_serial(array: ArrayGeometry, frames: int, faults: tuple[str, ...]) -> Passage:
    """A front-end in a process of its own, on a pseudo-terminal."""
    with tempfile.TemporaryDirectory() as folder:
        port = f"{folder}/port"
        source = SerialSource(SerialSettings(port=port), array)
        with _device(array, frames, "--serial", f"pty:{port}", *faults) as device, source:
            return _listen(source, frames, lambda: _report(device))


def over_virtual(array: ArrayGeometry, frames: int, faults: tuple[str, ...]) -> Passage:
    """A front-end in a thread of this process, on python-can's virtual bus."""
    rates = {
        name.removeprefix("--"): float(value) for name, value in zip(faults[::2], faults[1::2], strict=True)
    }
    loopback = {"scenario": _scenario(frames), **rates}
    settings = CanSettings.model_validate(
        {"interface": "virtual", "channel": "bench", "front_ends": (FrontEndAddress(),), "loopback": loopback}
    )
    with CanSource(settings, array) as source:
        return _listen(source, frames, source.simulated)


def over_multicast(array: ArrayGeometry, frames: int, faults: tuple[str, ...]) -> Passage:
    """A front-end in a process of its own, on python-can's UDP multicast bus."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = CanSettings(interface="udp_multicast", channel=GROUP, options={"port": port})
    bus = ("--can", f"udp_multicast:{GROUP}", "--option", f"port={port}")
    with CanSource(settings, array) as source, _device(array, frames, *bus, *faults) as device:
        return _listen(source, frames, lambda: _report(device))


def _listen(source: Source, frames: int, told: Callable[[], dict[str, int]]) -> Passage:
    """Read until every frame has come or is counted as lost."""
    arrived, lost, first, last = 0, 0, 0.0, time.perf_counter()
    cpu = time.process_time()
    while arrived + lost < frames:
        try:
            block = source.recv(0.1)
        except EndOfSource:
            break
        now = time.perf_counter()
        if block is not None:
            first, last = first or now, now
            arrived += len(block)
        elif now - last > GIVE_UP_S:
            raise OSError(f"after {arrived} of {frames} frames nothing came for {GIVE_UP_S:g} s")
        lost = sum(one["lost"] for one in source.details()["front_ends"].values())
    cpu = time.process_time() - cpu
    return Passage(arrived, lost, max(last - first, 1e-9), cpu, told())


@contextmanager
def _device(array: ArrayGeometry, frames: int, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    changes = {f"source.{key}": value for key, value in _scenario(frames).items()}
    changes |= {"array.antennas": array.antennas, "array.subcarriers": array.subcarriers}
    changes |= {"array.subcarrier_spacing_hz": array.subcarrier_spacing_hz}
    settings = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "chachart.node.commands.main", "frontend", "--json", *arguments]
    process = subprocess.Popen([*command, *settings], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        if not process.stdout.readline():
            raise OSError("the simulated front-end did not start")
        yield process
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def _report(device: subprocess.Popen[str]) -> dict[str, int]:
    out, _ = device.communicate(timeout=GIVE_UP_S)
    counts: dict[str, int] = json.loads(out.splitlines()[-1])
    return counts


def _scenario(frames: int) -> dict[str, Any]:
    return {"ues": 64, "frame_rate_hz": 0.0, "frames": frames}


def _frame_bytes(array: ArrayGeometry) -> int:
    return packet.csi_packet_bytes(array.antennas, array.subcarriers, SampleFormat.INT16)


def _can_decoder(array: ArrayGeometry, raw: list[bytes]) -> Callable[[], Any]:
    """ISO-TP messages of `raw` as a logger saw them, to be put together again."""
    import can

    from chachart.sources.frontend.isotp_link import IsoTpReceiver

    address = FrontEndAddress()
    messages = [
        can.Message(arbitration_id=address.id, data=data, is_fd=True, is_extended_id=False)
        for one in raw
        for data in _segments(one)
    ]

    def decode() -> None:
        intake = Intake(array, Counters())
        receiver = IsoTpReceiver((address,), len(raw[0]), Counters(), None, fd=True)
        for start in range(0, len(messages), MAX_MESSAGES):
            for name, one in receiver.feed(messages[start : start + MAX_MESSAGES]):
                intake.receive(name, one, 1)
        if len(intake) != len(raw):
            raise AssertionError(f"{len(intake)} of {len(raw)} frames came out of ISO-TP")

    return decode


def _segments(raw: bytes) -> Iterator[bytes]:
    """A long packet as the data of CAN FD messages (ISO 15765-2)."""
    head = (
        b"\x10\0" + len(raw).to_bytes(4, "big")
        if len(raw) > 0xFFF
        else (0x1000 | len(raw)).to_bytes(2, "big")
    )
    size = 64 - len(head)
    yield head + raw[:size]
    for n, start in enumerate(range(size, len(raw), 63), 1):
        yield (bytes([0x20 | n % 16]) + raw[start : start + 63]).ljust(64, b"\xcc")


def _add_rate(table: Table, name: str, timing: Timing, size: int) -> None:
    each = timing.scaled(1 / BLOCK)
    table.add(name, each.scaled(1e6), 1 / each.median, size / each.median / 1e6)
