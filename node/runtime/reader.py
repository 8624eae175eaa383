"""The thread that reads the source, feeds the CSI sinks, and cuts the stream into blocks per shard."""

from __future__ import annotations

import logging
import math
import mmap
import struct
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.runtime import messages
from chachart.node.runtime.antenna_looks import AntennaLooks
from chachart.node.runtime.partition import Partitioner
from chachart.node.runtime.progress import Applied, Mark, Marks, missing
from chachart.node.runtime.shard_queues import ShardQueues
from chachart.node.runtime.sink_thread import SinkThread
from chachart.node.runtime.thread_names import show_name
from chachart.sinks.plain import plain
from chachart.sources.base import EndOfSource, Source
from chachart.sources.checks import misfit

_COUNT = struct.Struct("<q")

log = logging.getLogger(__name__)

RECV_TIMEOUT_S = 0.1
ORDER = ("gaps", "out_of_order", "restamped")
MARK_EVERY_S = 0.1


class Tally:
    """A count that outlives the process that keeps it: a mapped file."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(_COUNT.size))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), _COUNT.size)

    def set(self, count: int) -> None:
        _COUNT.pack_into(self._memory, 0, count)


def read_tally(path: Path) -> int:
    """What the process that kept it counted last; 0 if it never did."""
    try:
        return int(_COUNT.unpack(path.read_bytes())[0])
    except (OSError, struct.error):
        return 0


class Reader:
    """Reads an open source until it ends, fails, or `stop` is called.

    Attributes
    ----------
    frames_in, blocks_in
        What came in and had the right shape.
    rejected
        What had not; the source's own rejects are with the source.
    order
        `gaps`: frames missing by the source's numbering; `out_of_order`: frames that came late; `restamped`:
        live frames whose time was too far from this host's.
    marks
        Where the source was, for whoever goes on from here.
    passed_on
        All frames below this number are in the queues.
    complaint
        What was wrong with the last block that had not the right shape.
    failure
        Why the source failed, where it did.
    antennas
        Looks at the antennas now and then.
    """

    def __init__(
        self,
        source: Source,
        partitioner: Partitioner,
        queues: ShardQueues,
        tally: Tally | None = None,
        time_tolerance_s: float = math.inf,
    ) -> None:
        self.frames_in = 0
        self.blocks_in = 0
        self.rejected = Counters()
        self.order = Counters()
        self.complaint: str | None = None
        self.failure: str | None = None
        self.sinks: tuple[SinkThread, ...] = ()
        self.marks = Marks()
        self.passed_on = 0
        self._asked_at: float | None = None
        self.antennas = AntennaLooks(source.array)
        self._source = source
        self._arrays = {array.name: array for array in source.others}
        self._partitioner = partitioner
        self._queues = queues
        self._tally = tally
        self._tolerance_ns = math.inf if source.lossless else time_tolerance_s * 1e9
        self._details_failed = False
        self._number = self._read_before = 0
        self._applied: Applied = []
        self._applied_below = 0
        self._next_mark = 0.0
        self._expected: int | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reader", daemon=True)

    def go_on(self, mark: Mark, applied: Applied, counted: dict[str, Any], read_before: int = 0) -> None:
        """Before `start`: the source goes on at a mark, what is in a state already is left out.

        Parameters
        ----------
        mark
            Where; its position is None if the source starts anew.
        applied
            What not to read again.
        counted
            The counts of who read before, as `status` gives them.
        read_before
            So many frames had been read: those and what was applied are read even after `stop` and in a
            pause, so that all UEs are at the same frame.
        """
        self._number = self.passed_on = mark.frame
        self._applied = applied
        self._applied_below = max((frame for _, _, frame in applied), default=0)
        self._read_before = max(read_before, self._applied_below)
        self.frames_in, self.blocks_in = counted["frames_in"], counted["blocks_in"]
        self.rejected.merge(counted["rejected"])
        self.order.merge({reason: counted[reason] for reason in ORDER})

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Read no further; what was read is still passed on."""
        self._stopping.set()

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return self._thread.ident is not None and not self._thread.is_alive()

    @property
    def source_silent_s(self) -> float:
        """For how long the source has not answered; a full queue and a slow sink are not its fault."""
        asked_at = self._asked_at
        return 0.0 if asked_at is None else time.monotonic() - asked_at

    def join(self, timeout: float) -> None:
        if self._thread.ident is not None:
            self._thread.join(timeout)

    def status(self) -> dict[str, Any]:
        """Counts for the node's status report."""
        rejected = Counters()
        rejected.merge(self.rejected.as_dict())
        rejected.merge(self._source.rejected.as_dict())
        return {
            "frames_in": self.frames_in,
            "blocks_in": self.blocks_in,
            "rejected": rejected.as_dict(),
            "antennas": self.antennas.report(),
            **dict.fromkeys(ORDER, 0),
            **self.order.as_dict(),
        }

    def details(self) -> dict[str, Any]:
        """What the source tells of itself; whatever is wrong with that harms nobody else."""
        try:
            details: dict[str, Any] = plain(self._source.details())
            messages.pack(details)  # what cannot be sent must not end the dispatcher
        except Exception as error:
            if not self._details_failed:
                log.exception("the source cannot tell its details")
            self._details_failed = True
            return {"error": f"{type(error).__name__}: {error}"}
        return details

    def _run(self) -> None:
        show_name()
        try:
            while not self._stopping.is_set() or self._number < self._read_before:
                self._step()
        except EndOfSource:
            log.info("the source has ended")
        except Exception as error:
            self.failure = f"the source failed: {error}"
            log.exception("the source failed")

    def _step(self) -> None:
        self._mark()
        self._source.catching_up = self._number < self._read_before
        self._asked_at = time.monotonic()
        block = self._source.recv(RECV_TIMEOUT_S)
        now, self._asked_at = time.monotonic(), None
        if block is not None and self._fits(block):
            if self._watched(block):
                self.antennas.see(block, now)
            self._take(block, now)
            self.passed_on = self._number

    def _take(self, block: CsiBlock, now: float) -> None:
        if self._tolerance_ns < math.inf:
            block = self._in_time(block)
        numbers = np.arange(self._number, self._number + len(block))
        self._number += len(block)
        if numbers[0] < self._applied_below:
            new = missing(block.ue, numbers, self._applied)
            if not new.any():
                return
            block, numbers = block.take(new), numbers[new]
        self.frames_in += len(block)
        self.blocks_in += 1
        if self._tally is not None:
            self._tally.set(self.frames_in)
        for sink in self.sinks:
            sink.put(block)
        # What is played again makes the same chart every time: there only [array] leaves antennas out.
        if not self._source.lossless and self._watched(block):
            block = self.antennas.without_dead(block)
        for part in self._partitioner.parts(block, now, numbers):
            self._queues.put(part)

    def _watched(self, block: CsiBlock) -> bool:
        """Whether a block is of the array whose antennas are watched: of several the first."""
        return not self._arrays or block.array == self._source.array.name

    def _in_time(self, block: CsiBlock) -> CsiBlock:
        """With this host's time for frames of another day: no frame must move what others live by."""
        now_ns = time.time_ns()
        off = np.abs(block.time_ns - now_ns) > self._tolerance_ns
        if not off.any():
            return block
        self.order.add("restamped", int(off.sum()))
        return replace(block, time_ns=np.where(off, now_ns, block.time_ns))

    def _mark(self) -> None:
        """Note where the source is, now and then."""
        if time.monotonic() >= self._next_mark:
            self._next_mark = time.monotonic() + MARK_EVERY_S
            self.marks.add(Mark(self._number, self._source.position()))

    def _fits(self, block: CsiBlock) -> bool:
        array = self._arrays.get(block.array, self._source.array)
        if (block.antennas, block.subcarriers) != (array.antennas, array.subcarriers):
            self.rejected.add("shape", len(block))
            self.complaint = misfit((block.antennas, block.subcarriers), array)
            return False
        if self._expected is not None and block.seq != self._expected:
            late = block.seq < self._expected
            self.order.add(
                "out_of_order" if late else "gaps", len(block) if late else block.seq - self._expected
            )
        self._expected = max(block.seq + len(block), self._expected or 0)
        return True
