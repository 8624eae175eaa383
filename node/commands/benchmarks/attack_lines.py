"""Floods on lines that a node listens to: mutated inputs on a serial line, a CAN bus, and UDP.

Every so often a good frame is among them, from a UE of its own: all of these must get into the chart.
"""

from __future__ import annotations

import socket as socketlib
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from chachart.node.commands.benchmarks.attack_inputs import block
from chachart.node.commands.benchmarks.attack_target import ask, patiently
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.commands.benchmarks.running import RunningNode
from chachart.node.data.extras import require
from chachart.sources.formats.wifi import tones
from chachart.sources.frontend import packet
from chachart.sources.live.wifi.encoding import ENCODERS, Packet

GOOD_EVERY = 50
GOOD_UE = 0xABCDEF
FIRST_GOOD = 100_000
"""Numbers of good frames begin here: inputs that a mutation left whole have others."""
BURST, PAUSE_S = 20, 0.004
"""UDP and multicast have no brake: faster than a node reads, the system drops datagrams, good ones too."""
_HERE, _GROUP = "127.0.0.1", "239.74.163.2"
_CAN_ID = 0x640
_SIZES = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a CAN FD message may have."""
_NEXMON = tuple(n for n in tones.carrying("ht", 20) if n not in (28, 29, 30))


@dataclass(frozen=True, slots=True)
class Line:
    """A node's array and source, and who throws so many inputs of a seed at its port; gives the good ones."""

    config: str
    throw: Callable[[int, int, int], int]
    node_comes_first: bool = True


def throw_on(name: str, port: int, count: int, seed: int) -> int:
    """Throw mutated inputs on a line; how many good frames were among them."""
    return LINES[name].throw(port, count, seed)


def line_config(name: str, port: int, web: int) -> str:
    """The configuration of a node that listens at `port` and shows at `web`."""
    sinks = f'[estimator]\naveraging = "mean"\nrho = "none"\n[[sinks]]\ntype = "view"\nport = {web}\n'
    return LINES[name].config.replace("PORT", str(port)) + sinks


def listening(node: RunningNode, web: int) -> None:
    """Wait until the node's source is open."""
    while not patiently(node, partial(ask, web, "status"))["source_details"]:
        node.rest(0.1)


def settled(node: RunningNode, web: int) -> tuple[int, int]:
    """How many good frames are in the chart, and how much was rejected, once nothing more comes in."""
    before, now = -1, 0
    while now != before:
        node.rest(1.0)
        status = patiently(node, partial(ask, web, "status"))
        before, now = now, status["frames_estimated"]
    chart = ask(web, "chart")
    frames = dict(zip(chart["ue"], chart["snapshots"], strict=True))
    return round(frames.get(GOOD_UE, 0)), sum(status["rejected"].values())


def _packet(seq: int, ue: int) -> bytes:
    """A packet of a front-end with 2 x 3 values."""
    samples = packet.SampleFormat.INT8
    made = packet.CsiPacket.quantise(seq, time.time_ns(), ue, block(1).csi[0], samples)
    return packet.encode(made)


def _mixed(samples: list[bytes], count: int, seed: int) -> Iterator[tuple[bool, bytes]]:
    """Mutated inputs; after every `GOOD_EVERY` of them it is time for a good one."""
    for n, data in enumerate(mutations(samples, seed, 0, count), 1):
        yield n % GOOD_EVERY == 0, data


def _serial(port: int, count: int, seed: int) -> int:
    """Over TCP, as a serial server: the node connects."""
    require("serial", "chachart bench attack:")
    from chachart.sources.frontend.framing import encode_frame

    good = 0
    with socketlib.create_server((_HERE, port)) as server, _visitor(server) as line:
        samples = [encode_frame(_packet(n, 1 + n)) for n in range(8)]
        for due, data in _mixed(samples, count, seed):
            line.sendall(data)
            if due:
                line.sendall(b"\0" + encode_frame(_packet(FIRST_GOOD + good, GOOD_UE)))
                good += 1
        line.shutdown(socketlib.SHUT_WR)
        while line.recv(4096):
            pass
    return good


def _visitor(server: socketlib.socket) -> socketlib.socket:
    """The first that stays: who only looks whether somebody listens hangs up at once."""
    while True:
        line, _ = server.accept()
        line.settimeout(0.5)
        try:
            if line.recv(1):
                line.settimeout(None)
                return line
        except TimeoutError:
            line.settimeout(None)
            return line
        line.close()


def _udp(port: int, count: int, seed: int) -> int:
    """Datagrams of Nexmon, an antenna each."""
    csi = 100 * np.exp(2j * np.pi * np.random.default_rng(seed).random((2, 64)))
    samples = [piece for n in range(4) for piece in ENCODERS["nexmon"](Packet(n, 1 + n, n, -50, csi))]
    good = 0
    with socketlib.socket(socketlib.AF_INET, socketlib.SOCK_DGRAM) as socket:
        for n, (due, data) in enumerate(_mixed(samples, count, seed)):
            made = ENCODERS["nexmon"](Packet(good, GOOD_UE, n, -50, csi)) if due else []
            good += due
            for piece in (data, *made):
                with suppress(ConnectionError):
                    socket.sendto(piece, (_HERE, port))
            if n % BURST == 0:
                time.sleep(PAUSE_S)
    return good


def _can(port: int, count: int, seed: int) -> int:
    """Messages of CAN FD on a multicast bus, which hold a packet each or what has become of one."""
    require("can", "chachart bench attack:")
    import can

    good = 0
    samples = [_single(_packet(n, 1 + n)) for n in range(8)]
    with can.Bus(_GROUP, "udp_multicast", ignore_config=True, port=port, fd=True) as bus:
        for n, (due, data) in enumerate(_mixed(samples, count, seed)):
            for piece in (data[:64], *([_single(_packet(FIRST_GOOD + good, GOOD_UE))] if due else [])):
                bus.send(_message(can, bytes(piece)))
            good += due
            if n % BURST == 0:
                time.sleep(PAUSE_S)
    return good


def _single(data: bytes) -> bytes:
    """An ISO-TP message of one frame of CAN FD."""
    return bytes((0, len(data))) + data


def _message(can: Any, data: bytes) -> Any:
    size = next(size for size in _SIZES if size >= len(data))
    return can.Message(arbitration_id=_CAN_ID, data=data.ljust(size, b"\0"), is_fd=True, is_extended_id=False)


_SMALL = """
[array]
antennas = 2
subcarriers = 3
subcarrier_spacing_hz = 312500.0
[source]
"""
_WIFI = f"""
[array]
antennas = 2
subcarriers = {len(_NEXMON)}
subcarrier_spacing_hz = 312500.0
tones = {list(_NEXMON)}
[source]
"""
LINES: dict[str, Line] = {
    "serial": Line(
        _SMALL + f'type = "serial"\nport = "socket://{_HERE}:PORT"\n', _serial, node_comes_first=False
    ),
    "can": Line(
        _SMALL
        + f'type = "can"\ninterface = "udp_multicast"\nchannel = "{_GROUP}"\noptions = {{ port = PORT }}\n',
        _can,
    ),
    "udp": Line(_WIFI + f'type = "wifi"\ntool = "nexmon"\nlisten = "{_HERE}"\nport = PORT\n', _udp),
}
