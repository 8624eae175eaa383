"""The dispatcher's end of the sockets to the workers: who is there, and when each was last heard of."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from chachart.node.data.counters import Counters
from chachart.node.net.doorkeeper import Doorkeeper
from chachart.node.net.security import SecuritySettings
from chachart.node.net.wire import encode_csi
from chachart.node.runtime import messages
from chachart.node.runtime.entries import Entry

Message = tuple[int, bytes, dict[str, Any], list[bytes]]


@dataclass(slots=True)
class Peer:
    """A worker that has said hello."""

    identity: bytes
    pid: int
    host: str
    heard_at: float
    status: dict[str, Any] = field(default_factory=dict)


class WorkerLinks:
    """One ROUTER socket for all workers.

    Parameters
    ----------
    context
        Whose socket it is.
    endpoint
        Where workers connect.
    keys
        Folder of the keys that let them in; None where nobody else can reach the endpoint.
    count
        How many shards there are, one worker each.

    Attributes
    ----------
    socket
        The socket.
    peers
        By shard, the worker that is there, or None.
    """

    def __init__(
        self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str, keys: str | None, count: int
    ) -> None:
        self.peers: list[Peer | None] = [None] * count
        self.socket = context.socket(zmq.ROUTER)
        self.socket.set_hwm(0)
        self._asked: set[bytes] = set()
        self._doorkeeper: Doorkeeper | None = None
        if keys is not None:
            self._doorkeeper = Doorkeeper(context, SecuritySettings(keys=Path(keys)), Counters(), ("send",))
            self._doorkeeper.guard(self.socket, endpoint)
        self.socket.bind(endpoint)

    def close(self) -> None:
        """Let nobody in any more; what was sent still goes out."""
        if self._doorkeeper is not None:
            self._doorkeeper.close()

    def receive(self) -> Iterator[Message]:
        """What has come: (shard, kind, values, further parts).

        A worker that is not known, because it talked to a feeder that is dead, is asked to say hello.
        """
        while True:
            try:
                identity, kind, *parts = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            values = messages.unpack(parts[0])
            if kind == messages.HELLO:
                yield values["shard"], kind, {**values, "identity": identity}, parts[1:]
                continue
            for shard, peer in enumerate(self.peers):
                if peer is not None and peer.identity == identity:
                    peer.heard_at = time.monotonic()
                    yield shard, kind, values, parts[1:]
                    break
            else:
                self._ask_who(identity)

    def send(self, shard: int, kind: bytes, values: dict[str, Any]) -> bool:
        """Send a message; whether there is somebody to send it to."""
        peer = self.peers[shard]
        if peer is None:
            return False
        self.socket.send_multipart([peer.identity, kind, messages.pack(values)])
        return True

    def send_block(self, shard: int, entry: Entry, mark: dict[str, Any] | None) -> None:
        """Send a block, with the latest mark before it where it is newer than the last one sent."""
        peer = self.peers[shard]
        assert peer is not None
        header = {
            "seq": entry.seq,
            "method": entry.method,
            "round": entry.round,
            "again": entry.acknowledged,
            "end": entry.content.end,
            "mark": mark,
        }
        parts = [peer.identity, messages.BLOCK, messages.pack(header), *encode_csi(entry.content.block)]
        self.socket.send_multipart(parts, copy=False)

    def _ask_who(self, identity: bytes) -> None:
        if identity not in self._asked:
            self._asked.add(identity)
            self.socket.send_multipart([identity, messages.WHO, messages.pack({})])
