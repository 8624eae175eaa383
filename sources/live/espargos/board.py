"""A simulated ESPARGOS board: its controller over HTTP, its stream over UDP, its sensors' errors."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.settings import Settings
from chachart.sources.base import EndOfSource, Source
from chachart.sources.live.device import SimulatedDevice
from chachart.sources.live.espargos import control, message, stream
from chachart.sources.live.espargos.calibration import trace_delay_s
from chachart.sources.live.espargos.cluster import ANTENNAS, Cluster
from chachart.sources.live.espargos.control import Channel
from chachart.sources.live.espargos.message import SUBCARRIER_SPACING_HZ, UNIT_NS, SensorCsi

LONGEST_BODY = 1 << 16
REFERENCE_HZ = 200.0
"""Reference packets a second while the switch is at the reference."""
BOARD_ADDRESS = 0x020000000001
LATE_PACKETS = 4
FULL_SCALE = 1500.0
"""What the gain control makes of a packet's largest value, of 2047."""


class BoardFaults(Settings):
    """What is wrong with a simulated board, and what goes wrong on the way."""

    corrupt: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message is damaged."""
    drop: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message is never sent."""
    reorder: float = Field(0.0, ge=0, le=1)
    """Fraction of the packets of which one sensor's message comes a few packets late."""
    clock_ns: float = Field(40.0, ge=0, le=1000)
    """Offsets of the sensors' clocks lie within so much of each other."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same faults, clocks and phases."""


@dataclass(slots=True)
class BoardReport:
    """What became of the packets: sent whole, of those late in part; dropped and corrupted at one sensor."""

    sent: int = 0
    dropped: int = 0
    corrupted: int = 0
    reordered: int = 0
    references: int = 0


class SimulatedBoard(SimulatedDevice):
    """A board that hears what a source says. `start` it, point an `espargos` source at `host`, `stop` it.

    Parameters
    ----------
    source
        Frames of 8 antennas and the tones of `message.TONES`; not open yet. Played while somebody streams.
    channel
        What the controller says it listens on.
    faults
        What is wrong.
    """

    def __init__(self, source: Source, channel: Channel, faults: BoardFaults) -> None:
        super().__init__()
        self.report = BoardReport()
        self._source, self._channel, self._faults = source, channel, faults
        self._rng = np.random.default_rng(faults.fault_seed)
        self._clock_s = self._rng.uniform(0, faults.clock_ns * 1e-9, ANTENNAS)
        self._phase = np.exp(1j * self._rng.uniform(-np.pi, np.pi, ANTENNAS))
        self._sequence: dict[int, int] = {}
        self._number = 0
        self._late: deque[tuple[int, bytes]] = deque()
        self._switch = control.ANTENNAS
        self._client: tuple[str, int] | None = None
        self._greeted = False
        self._stopping = threading.Event()
        self._boot_ns = time.time_ns() - 100_000_000_000
        self._http = _Http(("127.0.0.1", 0), self)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        self._threads = [
            threading.Thread(target=self._http.serve_forever, args=(0.05,), name="board-http", daemon=True),
            threading.Thread(target=self._play, name="board", daemon=True),
        ]

    @property
    def host(self) -> str:
        """Where its controller listens."""
        return f"127.0.0.1:{self._http.server_port}"

    @property
    def udp_port(self) -> int:
        """Where it wants signs of life."""
        return int(self._udp.getsockname()[1])

    def start(self) -> None:
        """Listen."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End everything."""
        self._stopping.set()
        if self._threads[0].ident is not None:
            self._http.shutdown()
            for thread in self._threads:
                thread.join()
        self._http.server_close()
        self._udp.close()

    def answer(self, path: str, body: bytes, client: str) -> str | None:
        """What the controller says to a request; None to one that it does not know."""
        if path == "/identify":
            return "ESPARGOS"
        if path == "/api_info":
            return json.dumps(
                {"api-major": 3, "api-minor": 0, "device": "espargos", "revision": "densiflorus"}
            )
        if path == "/get_wificonf":
            secondary = {0: 0, 1: 1, -1: 2}[self._channel.secondary]
            return json.dumps({"channel-primary": self._channel.primary, "channel-secondary": secondary})
        if path == "/set_csi_acquire_config":
            return "ok"
        if path == "/set_rfswitch":
            self._switch = int(body)
            return "ok"
        if path == "/stream_udp":
            wanted: dict[str, Any] = json.loads(body)
            self._client = (client, int(wanted["port"])) if wanted["enable"] else None
            self._greeted = False
            return "ok"
        return None

    def _play(self) -> None:
        with self._source:
            while not self._stopping.is_set():
                if self._client is None:
                    self._stopping.wait(0.01)
                elif not self._greeted:
                    self._send(stream.HELLO)
                    self._greeted = True
                elif self._switch == control.REFERENCE:
                    self._reference()
                    self._stopping.wait(1 / REFERENCE_HZ)
                elif not self._hear():
                    break
        self.ended.set()

    def _hear(self) -> bool:
        """Play what the source has; False when it has ended."""
        try:
            block = self._source.recv(0.05)
        except EndOfSource:
            self._release(everything=True)
            return False
        if block is not None:
            for ue, time_ns, csi in zip(block.ue.tolist(), block.time_ns.tolist(), block.csi, strict=True):
                self._packet(ue, time_ns, csi, calibration=False)
        return True

    def _reference(self) -> None:
        frequency = self._channel.packet_hz + message.TONES * SUBCARRIER_SPACING_HZ
        csi = np.exp(-2j * np.pi * trace_delay_s()[:, None] * frequency)
        self._packet(BOARD_ADDRESS, time.time_ns(), csi.astype(np.complex64), calibration=True)
        self.report.references += 1

    def _packet(self, ue: int, time_ns: int, csi: NDArray[np.complex64], *, calibration: bool) -> None:
        """Send what each sensor makes of a packet: phases, and where it takes the beginning to be."""
        began = (time_ns - self._boot_ns) * 1e-9 + self._rng.uniform(0, 1e-6) + self._clock_s
        half_ns = np.round(began * 1e9 / UNIT_NS).astype(np.int64) * round(2 * UNIT_NS)
        early = half_ns * 0.5e-9 - began
        first = SensorCsi(
            source=ue & (1 << 48) - 1,
            destination=(1 << 48) - 1,
            sequence=self._next(ue) << 4,
            retry=False,
            calibration=calibration,
            time_half_ns=0,
            csi=csi[0],
            rssi_dbm=-50,
            noise_dbm=-95,
            channel=self._channel.primary,
            secondary=self._channel.secondary,
        )
        tones = Cluster(first, csi, early).tones()
        turns = np.exp(
            2j * np.pi * SUBCARRIER_SPACING_HZ * early[:, None] * tones + 1j * self._rng.uniform(0, 2 * np.pi)
        )
        heard = csi * turns * self._phase[:, None]
        peak = float(np.abs(heard.view(np.float64)).max()) or 1.0
        gain = int(np.clip(np.floor(20 * np.log10(FULL_SCALE / peak)), -100, 100))
        messages = [
            message.encode_message(
                replace(first, csi=heard[n].astype(np.complex64), time_half_ns=int(half_ns[n])), gain
            )
            for n in range(ANTENNAS)
        ]
        self._dispatch(messages, calibration)

    def _dispatch(self, messages: list[bytes], calibration: bool) -> None:
        self._number += 1
        odd, fault = int(self._rng.integers(ANTENNAS)), float(self._rng.random())
        faults = self._faults
        if calibration:
            fault = 1.0
        for antenna, body in enumerate(messages):
            datagram = self._datagram(antenna, body)
            if antenna == odd and fault < faults.drop:
                self.report.dropped += 1
                continue
            if antenna == odd and fault < faults.drop + faults.corrupt:
                self.report.corrupted += 1
                datagram = self._datagram(antenna, self._damaged(body))
            elif antenna == odd and fault < faults.drop + faults.corrupt + faults.reorder:
                self.report.reordered += 1
                self._late.append((self._number + int(self._rng.integers(1, LATE_PACKETS)), datagram))
                continue
            self._send(datagram)
        if not calibration and fault >= faults.drop + faults.corrupt:
            self.report.sent += 1
        self._release()

    def _datagram(self, antenna: int, body: bytes) -> bytes:
        """A sensor packet; every other message comes in two fragments."""
        uid = antenna << 29 | (self._number & 0x1FFFFFFF) or 1
        cut = len(body) // 2 if self._number % 2 else len(body)
        parts = [body[:cut], body[cut:]] if cut < len(body) else [body]
        fragments = [stream.Fragment(uid, i, len(parts), part) for i, part in enumerate(parts)]
        return stream.encode_packet(fragments)

    def _damaged(self, body: bytes) -> bytes:
        at = int(self._rng.integers(8, len(body)))
        return body[:at] + bytes([body[at] ^ int(self._rng.integers(1, 256))]) + body[at + 1 :]

    def _release(self, everything: bool = False) -> None:
        while self._late and (everything or self._late[0][0] <= self._number):
            self._send(self._late.popleft()[1])

    def _send(self, datagram: bytes) -> None:
        client = self._client
        if client is not None:
            self._udp.sendto(datagram, client)

    def _next(self, ue: int) -> int:
        self._sequence[ue] = (self._sequence.get(ue, -1) + 1) % 4096
        return self._sequence[ue]


class _Http(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, address: tuple[str, int], board: SimulatedBoard) -> None:
        super().__init__(address, _Handler)
        self.board = board


class _Handler(BaseHTTPRequestHandler):
    server: _Http

    def do_GET(self) -> None:
        """Answer a question."""
        self._answer(b"")

    def do_POST(self) -> None:
        """Do as told."""
        self._answer(self.rfile.read(min(int(self.headers.get("Content-Length", 0)), LONGEST_BODY)))

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""

    def _answer(self, body: bytes) -> None:
        try:
            text = self.server.board.answer(self.path, body, self.client_address[0])
        except (ValueError, KeyError, TypeError) as error:
            self.send_error(400, str(error))
            return
        if text is None:
            self.send_error(404)
            return
        encoded = text.encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(encoded)))
        self.end_headers()
        self.wfile.write(encoded)
