"""CSI from producers that connect over ZeroMQ and send protocol 1."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, ClassVar, Literal

import zmq
from isal.isal_zlib import crc32
from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.doorkeeper import CUT_OFF, Doorkeeper, key_problems
from chachart.node.net.endpoints import Endpoint, bind, bind_problems, fixed
from chachart.node.net.limits import Refusals
from chachart.node.net.security import SecuritySettings, endpoint_exposure
from chachart.node.net.wire import MAX_CSI_BYTES, WireError, decode_csi_from
from chachart.sources.base import Source, SourceSettings
from chachart.sources.checks import misfit, usable
from chachart.sources.numbering import Numbering

GATHERED_FRAMES = 32
"""Shorter blocks that have arrived already are handed on as one: the node's work is by the block."""
LEAST_MESSAGE_BYTES = 16 * 1024 * 1024
FITTING_FRAMES = 64
"""So many frames of the array fit into a message, whatever the array."""
HARD_LIMIT = 4
"""Messages up to so many times longer than allowed are read; longer ones end the connection."""


class ZmqSettings(SourceSettings):
    """`type = "zmq"`: producers connect a PUSH socket and send CSI blocks of protocol 1."""

    type: Literal["zmq"] = "zmq"
    endpoint: Endpoint = "tcp://127.0.0.1:5555"
    """Where the node listens for producers."""
    lossless: bool = False
    """true makes producers wait when the node is too slow; false drops the oldest waiting block."""
    queue_blocks: int = Field(16, ge=1, le=1024)
    """Blocks that may wait in the socket, for each producer."""
    max_message_bytes: int | None = Field(None, ge=1024, le=256 * 1024 * 1024)
    """Longer messages are rejected as `too_long`; not set: 16 MiB, or what 64 frames of the array take."""

    def listens_on(self) -> str | None:
        """Its endpoint, unless any free one will do."""
        return fixed(self.endpoint)

    def exposure(self, security: SecuritySettings) -> list[str]:
        """An endpoint that other machines reach needs keys."""
        mistakes = endpoint_exposure('source "zmq"', self.endpoint, security)
        return mistakes + key_problems(self.endpoint, security)


class ZmqSource(Source):
    """A PULL socket. Every producer numbers its own frames; whoever starts anew may count from 0.

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
        fitting = FITTING_FRAMES * (8 * array.antennas * array.subcarriers + 1024)
        self._limit = self.settings.max_message_bytes or min(max(LEAST_MESSAGE_BYTES, fitting), MAX_CSI_BYTES)
        self._held: CsiBlock | None = None
        self._cut_off = 0

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
        self._socket.maxmsgsize = HARD_LIMIT * self._limit
        try:
            self._doorkeeper = Doorkeeper(
                self._context, self.security, self._refused, ("send",), sees_cuts=True
            )
            self._doorkeeper.guard(self._socket, self.settings.endpoint)
            self._endpoint = bind(self._socket, self.settings.endpoint)
        except SetupError:
            self.close()
            raise

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next good block, or as one the short ones that wait; bad ones on the way are counted."""
        deadline = time.monotonic() + timeout
        self._count_cut_off()
        held, self._held = self._held, None
        blocks = [] if held is None else [held]
        while sum(len(block) for block in blocks) < GATHERED_FRAMES:
            left = 0.0 if blocks else max(deadline - time.monotonic(), 0.0)
            if not self._socket.poll(math.ceil(left * 1e3)):
                break
            block = self._accept(self._socket.recv_multipart(copy=False))
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

    def _accept(self, frames: list[zmq.Frame]) -> CsiBlock | None:
        parts = [frame.buffer for frame in frames]
        longest = max(part.nbytes for part in parts)
        if longest > self._limit:
            self._reject("too_long", f"a message of {longest} bytes came, max_message_bytes is {self._limit}")
            return None
        try:
            producer, block = decode_csi_from(parts)
        except WireError as error:
            self._reject(error.reason, str(error))
            return None
        if block.array != self.array.name:
            self._reject("array", f'frames of array "{block.array}" came, the array is "{self.array.name}"')
            return None
        if (block.antennas, block.subcarriers) != (self.array.antennas, self.array.subcarriers):
            self._reject("shape", misfit((block.antennas, block.subcarriers), self.array))
            return None
        # Whoever does not say who it is is told apart by its connection.
        who = frames[0].get(zmq.SRCFD) if producer is None else producer
        seq = self._numbering.of(block, who, _checksum(parts))
        if seq is None:
            self.rejected.add("duplicate", len(block))
            return None
        good = usable(block, self.rejected)
        self._numbering.leave_out(len(block) - (0 if good is None else len(good)))
        return None if good is None else replace(good, seq=seq)

    def _count_cut_off(self) -> None:
        """Take over what the doorkeeper has seen in its own thread."""
        cut_off = self._refused.as_dict().get(CUT_OFF, 0)
        for _ in range(self._cut_off, cut_off):
            self._reject(
                "too_long",
                f"a message of more than {HARD_LIMIT * self._limit} bytes came and its connection was ended, "
                f"max_message_bytes is {self._limit}",
            )
        self._cut_off = cut_off

    def _reject(self, reason: str, complaint: str) -> None:
        self.rejected.add(reason)
        self.complaint = complaint


def _checksum(parts: list[memoryview]) -> int:
    """Of the header with UEs and times, and of some of the samples: what tells blocks apart, in no time."""
    csi = parts[1]
    some = min(1024, csi.nbytes)
    return crc32(csi[-some:], crc32(csi[:some], crc32(parts[0])))
