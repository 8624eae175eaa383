"""Where a feeder begins to read: where the one before it was, as far as workers and main process know."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from chachart.node.runtime.progress import Applied, Mark, highest
from chachart.node.runtime.reader import ORDER, Reader
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.sources.base import Source

log = logging.getLogger(__name__)

NOTHING_COUNTED: dict[str, Any] = {
    "frames_in": 0,
    "blocks_in": 0,
    "rejected": {},
    "dropped_here": {},
    **dict.fromkeys(ORDER, 0),
}


def go_on(
    hellos: Sequence[dict[str, Any]],
    oldest_mark: Mark,
    counted: dict[str, Any] | None,
    source: Source,
    queues: ShardQueues,
    reader: Reader,
) -> None:
    """Take up where an earlier feeder was, if there was one.

    Parameters
    ----------
    hellos
        What each worker said of its state.
    oldest_mark
        The lowest of the marks that they know.
    counted
        The last status of the feeder before; None if there was none.
    source, queues, reader
        Who goes on.
    """
    applied: Applied = highest(
        (int(shards), int(shard), int(frame)) for hello in hellos for shards, shard, frame in hello["applied"]
    )
    if counted is None and not applied:
        return
    counted = NOTHING_COUNTED | (counted or {})
    with queues.shard(0) as queue:
        queue.dropped.merge(counted["dropped_here"])
    mark, read_before = oldest_mark, counted["frames_in"]
    if source.position() is None:
        read_before = 0  # gone is gone
        mark, applied = Mark(max((frame for *_, frame in applied), default=0), None), []
        lost = counted["frames_in"] - queues.accounted()
        if lost > 0:
            with queues.shard(0) as queue:
                queue.dropped.add("feeder_lost", lost)
    elif mark.position is not None:
        source.resume(mark.position)
    log.info("reading goes on at frame %d", mark.frame)
    reader.go_on(mark, applied, counted | {"frames_in": queues.accounted()}, read_before)
