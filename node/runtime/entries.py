"""What a shard's queue holds, and what it finds when a worker comes up."""

from __future__ import annotations

import math
from dataclasses import dataclass

from chachart.node.runtime.partition import ShardBlock


@dataclass(slots=True, eq=False)
class Entry:
    """A block on its way.

    `seq` numbers the blocks of a shard in the order they were first sent, `method` (theta, rho) is what they
    were first sent to be estimated with, `round` how often the source had jumped in time then: they stay with
    the block, however often that is sent.
    """

    content: ShardBlock
    seq: int = -1
    method: tuple[str, str] = ("", "")
    round: int = 0
    deaths: int = 0
    sent_at: float = 0.0
    acknowledged: bool = False


@dataclass(slots=True, eq=False)
class Waiting:
    """What will be a block once its worker can take it."""

    parts: list[ShardBlock]
    frames: int

    @property
    def since(self) -> float:
        """When its first frame came in."""
        arrivals = self.parts[0].arrivals
        return arrivals[0][0] if arrivals else -math.inf


@dataclass(frozen=True, slots=True)
class Handover:
    """What `ShardQueue.worker_up` found.

    Attributes
    ----------
    lost
        Frames that are in nobody's state any more.
    ahead
        Whether the state holds blocks whose results never arrived.
    """

    lost: int
    ahead: bool
