"""What the node's own processes say to each other: msgpack maps, and chart updates as raw columns.

These messages never leave the node's private directory of sockets, so they favour speed; what goes to
subscribers is `chachart.node.net.wire`.
"""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS

HELLO = b"hello"
"""Worker to feeder: {shard, pid, host, ues, seq, applied, mark, totals}, who it is and what is in its state.
Source process to feeder: {}, it waits for a `go`."""
WHO = b"who"
"""Feeder to worker: {}, say hello again: the feeder that knew you is dead."""
CONFIGURE = b"configure"
"""Feeder to worker: {live, lost, rows}, the answer to its hello; `lost` frames will not be sent again, and
`rows` asks for all rows."""
ROWS = b"rows"
"""Worker to feeder: {}, then an update of rows that may or may not be known."""
ALIVE = b"alive"
"""Worker to feeder: {}, for want of anything else to say."""
BLOCK = b"block"
"""Feeder to worker: {seq, method: (theta, rho), round (how often time has jumped), again, end, mark}, then a
CSI message. Source process to feeder: {sent (frames before), position (behind it)}, then a CSI message."""
DONE = b"done"
"""Worker to feeder: {seqs, estimated, dropped, ...} and the update or nothing: acknowledgement and result."""
SNAPSHOT = b"snapshot"
"""Feeder to worker: {mark}, write your state down; all frames below the mark have been sent to you."""
SNAPSHOTTED = b"snapshotted"
"""Worker to feeder: {seq, seconds, error}."""
REQUEST = b"request"
"""Main to feeder to worker: {id, operation, arguments}."""
REPLY = b"reply"
"""Worker to feeder to main: {id, result} or {id, error}."""
END = b"end"
"""Feeder to worker: nothing more will come."""
GO = b"go"
"""Main to feeder: {}, start reading once all workers are there. Feeder to source process: {position}, begin
there."""
STOP = b"stop"
"""Main to feeder: {within_s}, stop reading and drain. Feeder to source process: {}, that was all."""
LOST = b"lost"
"""Main to feeder: {shard, pid}, that worker is dead."""
HUNG = b"hung"
"""Feeder to main: {shard, pid}, that worker does not answer."""
READY = b"ready"
"""Feeder to main: {lossless, where}, source and CSI sinks are open."""
SOURCE_READY = b"source ready"
"""Source process to main: {source}, the one of that number is open."""
STARTED = b"started"
"""Feeder to main: {}, all workers are there and reading begins."""
UPDATE = b"update"
"""Feeder to main: {arrivals}, (monotonic seconds, frames) pairs, then the update."""
STATUS = b"status"
"""Feeder to main: the feeder's counters. Source process to feeder: {rejected (since the last one), complaint,
details, ended}."""
SETUP_ERROR = b"setup error"
"""Feeder to main: {message}, what a user asked for cannot be."""
DRAINED = b"drained"
"""Feeder to main: the final counters; the feeder is about to exit."""


def pack(values: dict[str, Any]) -> bytes:
    """A map of plain values as bytes."""
    return bytes(msgpack.packb(values))


def unpack(data: bytes | memoryview) -> dict[str, Any]:
    """The map that `pack` was given."""
    values: dict[str, Any] = msgpack.unpackb(data)
    return values


def pack_update(update: ChartUpdate) -> bytes:
    """A chart update as raw columns: a tenth of the time that lists of numbers take."""
    columns = {
        name: np.ascontiguousarray(values, COLUMNS[name].dtype).tobytes()
        for name, values in update.columns.items()
    }
    head = {"array": update.array, "theta": update.method.theta, "rho": update.method.rho}
    return pack({**head, "rows": len(update), "columns": columns})


def unpack_update(data: bytes | memoryview) -> ChartUpdate:
    """The update that `pack_update` was given."""
    values = unpack(data)
    columns = {name: np.frombuffer(raw, COLUMNS[name].dtype) for name, raw in values["columns"].items()}
    for name, column in columns.items():
        if COLUMNS[name].parts:
            columns[name] = column.reshape(COLUMNS[name].shape(values["rows"]))
    return ChartUpdate(values["array"], Method(values["theta"], values["rho"]), **columns)
