"""CSI from producers that connect over ZeroMQ and send protocol 1."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from dataclasses import replace
from typing import Any, ClassVar, Literal

import zmq
from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.doorkeeper import Doorkeeper, key_problems
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed
from chachart.node.net.limits import Refusals
from chachart.node.net.security import SecuritySettings, endpoint_exposure
from chachart.node.net.wire import WireError, decode_csi
from chachart.sources.base import Source, SourceSettings
from chachart.sources.checks import usable

GATHERED_FRAMES = 32
"""Shorter blocks that have arrived already are handed on as one: the node's work is by the block."""
REMEMBERED_BLOCKS = 1024
"""Duplicates are recognised among so many blocks."""
LONGEST_GAP = 10_000_000
"""A jump in the numbering by more frames is a producer that counts anew."""


class ZmqSettings(SourceSettings):
    """`type = "zmq"`: producers connect a PUSH socket and send CSI blocks of protocol 1."""

    type: Literal["zmq"] = "zmq"
    endpoint: Endpoint = "tcp://127.0.0.1:5555"
    """Where the node listens for producers."""
    lossless: bool = False
    """true makes producers wait when the node is too slow; false drops the oldest waiting block."""
    queue_blocks: int = Field(16, ge=1, le=1024)
    """Blocks that may wait in the socket, for each producer."""
    max_message_bytes: int = Field(16 * 1024 * 1024, ge=1024, le=256 * 1024 * 1024)
    """A producer that sends a longer message is disconnected."""

    def listens_on(self) -> str | None:
        """Its endpoint, unless any free one will do."""
        return fixed(self.endpoint)

    def exposure(self, security: SecuritySettings) -> list[str]:
        """An endpoint that other machines reach needs keys."""
        mistakes = endpoint_exposure('source "zmq"', self.endpoint, security)
        return mistakes + key_problems(self.endpoint, security)


class ZmqSource(Source):
    """A PULL socket. One producer numbers the frames of the array; whoever starts anew may count from 0.

    Messages that are no blocks of this array are counted in `rejected` by reason, one each; frames of a block
    that are not usable are counted one by one.
    """

    Settings: ClassVar[type[SourceSettings]] = ZmqSettings
    settings: ZmqSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self.lossless = self.settings.lossless
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._doorkeeper: Doorkeeper | None = None
        self._refused = Refusals("source zmq")
        self._endpoint = self.settings.endpoint
        self._numbering = Numbering()
        self._held: CsiBlock | None = None

    @classmethod
    def problems(cls, settings: ZmqSettings) -> list[str]:
        """Whether the endpoint is free."""
        return bind_problems(settings.endpoint)

    def open(self) -> None:
        """Listen.

        Raises
        ------
        SetupError
            If the endpoint is in use or does not exist here.
        """
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PULL)
        self._socket.rcvhwm = self.settings.queue_blocks
        self._socket.maxmsgsize = self.settings.max_message_bytes
        try:
            self._doorkeeper = Doorkeeper(self._context, self.security, self._refused, ("send",))
            self._doorkeeper.guard(self._socket, self.settings.endpoint)
            self._endpoint = bind(self._socket, self.settings.endpoint)
        except SetupError:
            self.close()
            raise

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next good block, or as one the short ones that wait; bad ones on the way are counted."""
        deadline = time.monotonic() + timeout
        held, self._held = self._held, None
        blocks = [] if held is None else [held]
        while sum(len(block) for block in blocks) < GATHERED_FRAMES:
            left = 0.0 if blocks else max(deadline - time.monotonic(), 0.0)
            if not self._socket.poll(math.ceil(left * 1e3)):
                break
            block = self._accept([part.buffer for part in self._socket.recv_multipart(copy=False)])
            if block is None and time.monotonic() >= deadline:
                break
            if block is not None and blocks and block.seq != blocks[-1].seq + len(blocks[-1]):
                self._held = block
                break
            if block is not None:
                blocks.append(block)
        return CsiBlock.concatenate(blocks) if blocks else None

    def close(self) -> None:
        """Stop listening."""
        if self._doorkeeper is not None:
            self._doorkeeper.close()
            self._doorkeeper = None
        if self._context is not None:
            self._context.destroy(linger=0)
            self._context = None

    def details(self) -> dict[str, Any]:
        """Where producers connect, how many there are, how often one began to count anew, who was refused."""
        return {
            "endpoint": self._endpoint,
            "restarts": self._numbering.restarts,
            "producers": 0 if self._doorkeeper is None else self._doorkeeper.connections,
            "refused": self._refused.as_dict(),
        }

    def _accept(self, parts: list[memoryview]) -> CsiBlock | None:
        try:
            block = decode_csi(parts)
        except WireError as error:
            self.rejected.add(error.reason)
            return None
        if block.array != self.array.name:
            self.rejected.add("array")
            return None
        if (block.antennas, block.subcarriers) != (self.array.antennas, self.array.subcarriers):
            self.rejected.add("shape")
            return None
        seq = self._numbering.of(block)
        if seq is None:
            self.rejected.add("duplicate", len(block))
            return None
        good = usable(block, self.rejected)
        self._numbering.leave_out(len(block) - (0 if good is None else len(good)))
        return None if good is None else replace(good, seq=seq)


class Numbering:
    """One numbering of the usable frames of a stream whose producer may repeat itself or start anew.

    Gaps and late blocks stay visible in the numbers; whoever reads the source counts them.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._recent: OrderedDict[tuple[int, int, int], None] = OrderedDict()
        self._offset = 0
        self._expected = 0
        self._latest_ns = 0

    def of(self, block: CsiBlock) -> int | None:
        """The number of the block's first frame, or None for a block that came before."""
        key = (block.seq, int(block.time_ns[0]), len(block))
        if key in self._recent:
            return None
        first = not self._recent
        self._recent[key] = None
        if len(self._recent) > REMEMBERED_BLOCKS:
            self._recent.popitem(last=False)
        if first:
            self._offset, self._expected = -block.seq, block.seq
        elif self._counts_anew(block):
            self.restarts += 1
            self._offset += self._expected - block.seq
            self._expected = block.seq
        number = max(block.seq + self._offset, 0)
        self._expected = max(self._expected, block.seq + len(block))
        self._latest_ns = max(self._latest_ns, int(block.time_ns.max()))
        return number

    def leave_out(self, frames: int) -> None:
        """Give no numbers to the last `frames` frames."""
        self._offset -= frames

    def _counts_anew(self, block: CsiBlock) -> bool:
        """A low number on a new frame, or a jump beyond reason."""
        ahead = block.seq - self._expected
        return ahead > LONGEST_GAP or (ahead < 0 and int(block.time_ns.min()) > self._latest_ns)
