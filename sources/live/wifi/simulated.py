"""A simulated Wi-Fi tool: what a source says, in the tool's own records, on the tool's own way."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.settings import Settings
from chachart.sources.base import EndOfSource, Source
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice
from chachart.sources.live.wifi.cutting import PicoScenesForwarder
from chachart.sources.live.wifi.encoding import ENCODERS, FULL_SCALE, SUBCARRIERS, Packet
from chachart.sources.live.wifi.frames import tone_places
from chachart.sources.live.wifi.tools import ToolName, decoder
from chachart.sources.live.wifi.ways import SerialPort, StandardInput, TcpServer, Udp, Way

RSSI_DBM = -50.0
"""Of a frame whose values have the mean square 1."""
LARGEST_PART = 4000
"""The simulated PicoScenes cuts frames into parts of so many bytes."""
LONGEST_COMMAND = 4096
_DATAGRAMS = ("nexmon", "picoscenes", "feitcsi", "openwifi")
_POLL_S = 0.05


class ToolFaults(Settings):
    """What goes wrong on a simulated tool's way."""

    drop: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that are never sent, as a whole."""
    corrupt: float = Field(0.0, ge=0, le=1)
    """Fraction of the frames that are sent cut short; on streams, where others would be lost too, with a
    header that makes no sense."""
    reorder: float = Field(0.0, ge=0, le=1)
    """Fraction of the whole frames whose last datagram comes after the next frame's first; streams keep
    their order."""
    fault_seed: int = Field(0, ge=0)
    """Same seed, same faults."""


@dataclass(slots=True)
class ToolReport:
    """Frames that were sent whole, never, and damaged, and how many of the whole ones came out of order."""

    sent: int = 0
    dropped: int = 0
    corrupted: int = 0
    reordered: int = 0


class SimulatedTool(SimulatedDevice):
    """A tool. In this process `way` is its other end; elsewhere it sends to `address`, or listens there.

    Raises
    ------
    SetupError
        If the source's array is not one that the tool can measure.
    """

    def __init__(
        self, tool: ToolName, source: Source, faults: ToolFaults, address: Address = ANY_PORT
    ) -> None:
        super().__init__()
        self._tool, self._source, self._faults, self._address = tool, source, faults, address
        self._encode, self._scale = ENCODERS[tool], FULL_SCALE.get(tool, 1000.0)
        self._report = ToolReport()
        self._rng = np.random.default_rng(faults.fault_seed)
        self._place = self._places()
        self._number = 0
        self._stopping = threading.Event()
        self._ready = threading.Event()
        self._send: Callable[[bytes], None] | None = None
        self._late: list[bytes] = []
        self._held: list[socket.socket | int] = []
        self._asked: socket.socket | None = None
        self._where = f"tool={tool} port={address[1]}"
        self._thread = threading.Thread(target=self._play, name="wifi-tool", daemon=True)

    @property
    def where(self) -> str:
        """What the source is to be told."""
        return self._where

    @property
    def report(self) -> ToolReport:
        """What has become of what it sent."""
        return self._report

    def start(self) -> None:
        """Begin; frames are sent once somebody is there."""
        if self._address[1]:
            self._meet_elsewhere()
        self._thread.start()

    def stop(self) -> None:
        """End everything."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        for held in self._held:
            os.close(held) if isinstance(held, int) else held.close()
        self._held.clear()

    def way(self) -> Way:
        """The other end, for a source in this process."""
        if self._tool == "esp32":
            return SerialPort(self._terminal(), 115_200)
        if self._tool == "nexmon_pcap":
            reading, writing = os.pipe()
            self._held += [reading, writing]
            self._meet(lambda piece: self._write(writing, piece))
            return StandardInput(reading)
        if self._tool == "feitcsi":
            return Udp(ANY_PORT, self._listening(), ask="--mode measure", stop="stop")
        if self._tool == "intel5300":
            server = TcpServer(ANY_PORT)
            self._connect(("127.0.0.1", server.port))
            return server
        udp = Udp(ANY_PORT)
        self._send_to(("127.0.0.1", udp.port))
        return udp

    def _meet_elsewhere(self) -> None:
        """Reach a source in another process, or let it come."""
        match self._tool:
            case "esp32":
                self._where = f"tool=esp32 serial_port={self._terminal()}"
            case "intel5300":
                self._connect(self._address)
            case "feitcsi":
                host, port = self._listening()
                self._where = f"tool=feitcsi host={host} port={port}"
            case "nexmon_pcap":
                raise SetupError(
                    "nexmon_pcap comes on standard input: give the node a file, or tcpdump's output"
                )
            case _:
                self._send_to(self._address)

    def _meet(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._ready.set()

    def _send_to(self, far: Address) -> None:
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._held.append(sender)
        self._send_from(sender, far)

    def _send_from(self, sender: socket.socket, far: Address) -> None:
        self._meet(lambda piece: _quietly(sender, piece, far))

    def _connect(self, far: Address) -> None:
        try:
            stream = socket.create_connection(far, timeout=3.0)
        except OSError as error:
            raise SetupError(f"nobody listens at {far[0]}:{far[1]}: {error.strerror or error}") from None
        self._held.append(stream)
        self._meet(stream.sendall)

    def _listening(self) -> Address:
        """Listen for a client's command, as FeitCSI does; what it is told goes to whoever told it."""
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            made.bind(self._address)
        except OSError as error:
            made.close()
            where = f"{self._address[0]}:{self._address[1]}"
            raise SetupError(f"{where} cannot be listened at: {error.strerror}") from None
        made.setblocking(False)
        self._held.append(made)
        self._asked = made
        host, port = made.getsockname()[:2]
        return str(host), int(port)

    def _hear_commands(self) -> None:
        """A command begins, `stop` ends."""
        assert self._asked is not None
        try:
            command, client = self._asked.recvfrom(LONGEST_COMMAND)
        except (BlockingIOError, ConnectionError):
            return
        if command == b"stop":
            self._send = None
            self._ready.clear()
        else:
            self._send_from(self._asked, client)

    def _terminal(self) -> str:
        master, other = os.openpty()
        tty.setraw(other)
        self._held += [master, other]
        self._meet(lambda piece: self._write(master, piece))
        return os.ttyname(other)

    def _write(self, file: int, piece: bytes) -> None:
        left = memoryview(piece)
        while left and not self._stopping.is_set():
            if select.select([], [file], [], _POLL_S)[1]:
                left = left[os.write(file, left[:1024]) :]

    def _places(self) -> list[int]:
        """Which of the tool's subcarriers are the array's, told by the tool's own decoder."""
        array, count = self._source.array, SUBCARRIERS.get(self._tool, 64)
        sample = Packet(0, 1, 0, -50, np.ones((array.antennas, count), np.complex128))
        decode = decoder(self._tool, "integers", 8, Counters())
        pieces = self._encode(sample)
        if self._tool == "picoscenes":
            pieces = PicoScenesForwarder.encode(pieces[0], 0)
        [log] = decode.feed(pieces) or decode.feed([])
        [group] = log.groups
        place = tone_places(group.kind.tones, count, array)
        if place is None or group.kind.antennas != array.antennas:
            raise SetupError(
                f"[array] {array.antennas} antennas x {array.subcarriers} subcarriers: {self._tool} measures "
                f"{group.kind.antennas} x {count}, numbered {group.kind.tones.numbers}"
            )
        return place

    def _play(self) -> None:
        with self._source:
            while not self._stopping.is_set():
                if self._asked is not None:
                    self._hear_commands()
                if self._send is None:
                    self._ready.wait(_POLL_S)
                    continue
                try:
                    block = self._source.recv(_POLL_S)
                except EndOfSource:
                    break
                if block is not None and not self._sends(block):
                    break
        if self._send is not None:
            for piece in self._late:
                self._send(piece)
        self.ended.set()

    def _sends(self, block: CsiBlock) -> bool:
        """Send the packets of a block; False when the source has hung up."""
        for ue, time_ns, csi in zip(block.ue.tolist(), block.time_ns.tolist(), block.csi, strict=True):
            try:
                self._packet(ue, time_ns, csi)
            except OSError:
                return False
        return True

    def _packet(self, ue: int, time_ns: int, csi: NDArray[np.complex64]) -> None:
        assert self._send is not None
        power = float(np.mean(np.abs(csi) ** 2)) or 1.0
        values = np.zeros((len(csi), SUBCARRIERS.get(self._tool, 64)), np.complex128)
        values[:, self._place] = csi * (self._scale / float(np.abs(csi.view(np.float32)).max()))
        rssi = int(np.clip(round(RSSI_DBM + 10 * np.log10(power)), -120, -1))
        packet = Packet(self._number, ue & (1 << 48) - 1, time_ns // 1000, rssi, values)
        self._number += 1
        pieces = self._encode(packet)
        fault = float(self._rng.random())
        if fault < self._faults.drop:
            self._report.dropped += 1
            return
        if self._tool == "picoscenes":
            pieces = PicoScenesForwarder.encode(pieces[0], packet.number % 65536, LARGEST_PART)
        late, self._late = self._late, []
        damaged = self._faults.drop + self._faults.corrupt
        if fault < damaged:
            self._report.corrupted += 1
            pieces = [_spoilt(self._tool, pieces[0], len(csi)), *pieces[1:]]
        else:
            self._report.sent += 1
            if fault < damaged + self._faults.reorder and self._tool in _DATAGRAMS:
                self._report.reordered += 1
                self._late = [pieces.pop()]
        for piece in [*pieces[:1], *late, *pieces[1:]]:
            self._send(piece)


def _spoilt(tool: ToolName, piece: bytes, antennas: int) -> bytes:
    """A piece without some of its last bytes; a line keeps its end, a record of a stream has a wrong head."""
    found = bytearray(piece)
    if tool == "intel5300":  # the number of antennas, 12 bytes before the CSI
        found[-((30 * (16 * antennas + 3) + 7) // 8) - 12] = 0
        return bytes(found)
    if tool == "nexmon_pcap":  # the number that every payload begins with, behind the file's and four heads
        found[58 + (24 if piece[:4] == b"\xd4\xc3\xb2\xa1" else 0)] = 0
        return bytes(found)
    return piece[: len(piece) - 37] + (b"\r\n" if piece.endswith(b"\n") else b"")


def _quietly(sender: socket.socket, piece: bytes, far: Address) -> None:
    try:
        sender.sendto(piece, far)
    except ConnectionError:
        time.sleep(0.001)  # nobody listens there at the moment: as on the air, it is lost
