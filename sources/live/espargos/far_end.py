"""The far ends of the ways to a simulated ESPARGOS board: a network, and a serial line."""

from __future__ import annotations

import json
import os
import select
import socket
import threading
import tty
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.sources.base import Source
from chachart.sources.live.device import CodecError
from chachart.sources.live.espargos import stream, uart
from chachart.sources.live.espargos.board import BoardFaults, BoardReport, SimulatedBoard, Wiring
from chachart.sources.live.espargos.control import Channel
from chachart.sources.live.espargos.uart import Kind, UartFrame
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice

LONGEST_BODY = 1 << 16


class NetworkBoard(SimulatedBoard):
    """A board behind HTTP and UDP: point an `espargos` source at `host`.

    Raises
    ------
    SetupError
        If it cannot listen at `address`.
    """

    def __init__(
        self,
        source: Source,
        channel: Channel,
        faults: BoardFaults,
        address: Address = ANY_PORT,
        wiring: Wiring | None = None,
    ) -> None:
        super().__init__(source, channel, faults, wiring)
        self._client: tuple[str, int] | None = None
        try:
            self._http = _Http(address, self)
        except OSError as error:
            raise SetupError(f"{address[0]}:{address[1]} cannot be listened at: {error.strerror}") from None
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind((address[0], 0))
        serve = self._http.serve_forever
        self._listening = threading.Thread(target=serve, args=(0.05,), name="board-http", daemon=True)

    @property
    def host(self) -> str:
        """Where its controller listens."""
        return f"{self._http.server_address[0]!s}:{self._http.server_port}"

    @property
    def udp_port(self) -> int:
        """Where it wants signs of life."""
        return int(self._udp.getsockname()[1])

    @property
    def where(self) -> str:
        """Its controller's address, and where it wants signs of life."""
        return f'boards=[{{host="{self.host}"}}] udp_port={self.udp_port}'

    def start(self) -> None:
        """Listen."""
        self._listening.start()
        super().start()

    def stop(self) -> None:
        """End everything."""
        super().stop()
        if self._listening.ident is not None:
            self._http.shutdown()
            self._listening.join()
        self._http.server_close()
        self._udp.close()

    def asked(self, path: str, body: bytes, client: str) -> str | None:
        """What the controller says to a request; None to one that it does not know."""
        if path != "/stream_udp":
            return self.answer(path, body)
        wanted: dict[str, Any] = json.loads(body)
        self._client = (client, int(wanted["port"])) if wanted["enable"] else None
        return "ok"

    @property
    def listened(self) -> bool:
        """See `SimulatedBoard`."""
        return self._client is not None

    def greet(self) -> None:
        """See `SimulatedBoard`."""
        self.send(stream.HELLO)

    def send(self, packet: bytes) -> None:
        """See `SimulatedBoard`."""
        client = self._client
        if client is not None:
            self._udp.sendto(packet, client)


class WiredBoards(SimulatedDevice):
    """Boards on one clock that hear the same packets, as one device."""

    def __init__(self, boards: list[NetworkBoard]) -> None:
        super().__init__()
        self.boards = boards

    @property
    def where(self) -> str:
        """Their controllers' addresses, and where the first wants signs of life."""
        hosts = ",".join(f'{{host="{board.host}"}}' for board in self.boards)
        return f"boards=[{hosts}] udp_port={self.boards[0].udp_port}"

    @property
    def report(self) -> BoardReport:
        """What has become of what all sent."""
        total = BoardReport()
        for board in self.boards:
            for name, count in asdict(board.report).items():
                setattr(total, name, getattr(total, name) + count)
        return total

    def start(self) -> None:
        """Listen."""
        for board in self.boards:
            board.start()

    def stop(self) -> None:
        """End everything."""
        for board in self.boards:
            board.stop()
        self.ended.set()


class SerialBoard(SimulatedBoard):
    """A board at the other end of a pseudo-terminal: point an `espargos` source's `serial_port` at `port`."""

    def __init__(self, source: Source, channel: Channel, faults: BoardFaults) -> None:
        super().__init__(source, channel, faults)
        self._master, self._other = os.openpty()
        tty.setraw(self._other)
        self._listened = False
        self._writing = threading.Lock()
        self._reading = threading.Thread(target=self._read, name="board-serial", daemon=True)

    @property
    def port(self) -> str:
        """What to open."""
        return os.ttyname(self._other)

    @property
    def where(self) -> str:
        """The terminal."""
        return f'boards=[{{serial_port="{self.port}"}}]'

    def start(self) -> None:
        """Listen."""
        self._reading.start()
        super().start()

    def stop(self) -> None:
        """End everything."""
        super().stop()
        if self._reading.ident is not None:
            self._reading.join()
        os.close(self._master)
        os.close(self._other)

    @property
    def listened(self) -> bool:
        """See `SimulatedBoard`."""
        return self._listened

    def greet(self) -> None:
        """A serial line has no greeting of its own."""

    def send(self, packet: bytes) -> None:
        """See `SimulatedBoard`."""
        self._write(UartFrame(Kind.SENSOR_PACKET, 0, packet))

    def _write(self, frame: UartFrame) -> None:
        from cobs import cobs

        left = memoryview(cobs.encode(uart.encode(frame)) + b"\0")
        with self._writing:
            while left and not self._stopping.is_set():
                if select.select([], [self._master], [], 0.1)[1]:
                    left = left[os.write(self._master, left[:1024]) :]

    def _read(self) -> None:
        from chachart.sources.frontend.framing import StreamDecoder

        decoder = StreamDecoder(LONGEST_BODY, Counters())
        while not self._stopping.is_set():
            if select.select([self._master], [], [], 0.05)[0]:
                for piece in decoder.feed(os.read(self._master, 4096)):
                    try:
                        self._hear_frame(uart.decode(piece))
                    except CodecError:
                        continue  # as a controller does: what it does not understand it does not answer

    def _hear_frame(self, frame: UartFrame) -> None:
        if frame.kind == Kind.HELLO:
            hello = uart.hello_response("espargos", "densiflorus", 3, 0)
            self._write(UartFrame(Kind.HELLO_RESPONSE, frame.number, hello))
        elif frame.kind == Kind.REQUEST:
            text = self.answer(*uart.parse_request(frame.payload))
            answer = uart.response(404, b"") if text is None else uart.response(200, text.encode())
            self._write(UartFrame(Kind.RESPONSE, frame.number, answer))
        elif frame.kind == Kind.STREAM_CONTROL and frame.payload[:1] == bytes([uart.SENSOR_DATA]):
            self._listened = frame.payload[1:2] == b"\x01"


class _Http(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, address: tuple[str, int], board: NetworkBoard) -> None:
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
            text = self.server.board.asked(self.path, body, self.client_address[0])
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
