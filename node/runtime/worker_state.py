"""What a worker knows, written down and taken up again."""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.node.estimation.snapshots import joined, merged
from chachart.node.estimation.state import Snapshot
from chachart.node.files.folders import Folder, FolderError
from chachart.node.runtime.partition import shard_of
from chachart.node.runtime.processor import BlockProcessor
from chachart.node.runtime.progress import START, Applied, Mark, highest
from chachart.node.runtime.state_files import counts, worker_series

log = logging.getLogger(__name__)

PIECE_UES = 4096
ROWS_NAME = "rows"
UNKNOWN_ERROR = 255
REASON_BYTES = 1024


@dataclass(slots=True)
class Done:
    """How far a worker is, and what became of the frames.

    Attributes
    ----------
    seq
        The last block that is in its state, -1 for none.
    round
        How often the source has jumped in time.
    applied, mark
        See `progress`.
    estimated, rejected
        Frames since the beginning.
    """

    seq: int = -1
    round: int = 0
    applied: Applied = field(default_factory=list)
    mark: Mark = START
    estimated: int = 0
    rejected: Counters = field(default_factory=Counters)

    def applied_below(self, shards: int, shard: int, frame: int) -> None:
        """All frames of that shard below `frame` are in the state, too."""
        self.applied = [(n, s, f) for n, s, f in self.applied if f > frame and (n, s) != (shards, shard)] + [
            (shards, shard, max([frame, *(f for n, s, f in self.applied if (n, s) == (shards, shard))]))
        ]

    def facts(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "seq": self.seq,
            "round": self.round,
            "applied": self.applied,
            "mark": {"frame": self.mark.frame, "position": self.mark.position},
            "totals": {"estimated": self.estimated, "rejected": self.rejected.as_dict()},
        }

    @classmethod
    def of(cls, facts: dict[str, Any]) -> Done:
        """What `facts` was given."""
        totals, rejected = facts["totals"], Counters()
        rejected.merge(totals["rejected"])
        applied = [(int(n), int(shard), int(frame)) for n, shard, frame in facts["applied"]]
        return cls(
            facts["seq"], facts["round"], applied, Mark(**facts["mark"]), totals["estimated"], rejected
        )


class WorkerState:
    """Writes the snapshots of one worker, and reads them.

    Parameters
    ----------
    folder
        Where they are; None for nowhere.
    shard, count
        Whose.
    durable
        Whether they must outlive the machine.
    """

    def __init__(self, folder: Folder | None, shard: int, count: int, durable: bool) -> None:
        self._folder = folder
        self._shard = shard
        self._count = count
        self._durable = durable
        self._writer: int | None = None
        self._reason = -1

    @property
    def writing(self) -> bool:
        """Whether a snapshot is being written."""
        return self._writer is not None

    def restore(self, processor: BlockProcessor) -> Done:
        """Take up the newest snapshot that can be read: its own, or those of another number of workers.

        Raises
        ------
        FolderError
            If the folder of the run is out of reach: to begin with nothing would be to forget.
        """
        if self._folder is None:
            return Done()
        if not self._folder.is_there():
            raise FolderError(errno.ENOENT, "it is not there, as seen from this worker")
        worker_series(self._folder, self._shard, self._count, True).forget_unfinished()
        for count in counts(self._folder, self._shard, self._count):
            own = count == self._count
            done = self._take_own(processor) if own else self._take_share(processor, count)
            if done is not None:
                return done
        return Done()

    def _take_own(self, processor: BlockProcessor) -> Done | None:
        """This worker's own snapshot."""
        assert self._folder is not None
        for path, facts, arrays in worker_series(self._folder, self._shard, self._count, True).newest():
            try:
                processor.restore(*_read(arrays))
                return Done.of(facts)
            except (ValueError, KeyError) as error:
                log.error("%s does not fit: %s", path, error)
        return None

    def _take_share(self, processor: BlockProcessor, count: int) -> Done | None:
        """This worker's UEs out of the snapshots of `count` others."""
        assert self._folder is not None
        snapshots: list[Snapshot] = []
        rows: list[dict[str, NDArray[Any]]] = []
        found: list[Done] = []
        for shard in range(count):
            for _, facts, arrays in worker_series(self._folder, shard, count, True).newest():
                snapshot, columns = _read(arrays)
                snapshots.append(snapshot)
                rows += [columns] if columns else []
                found.append(Done.of(facts))
                break
            else:
                return None
        try:
            snapshot = merged(snapshots, lambda ue: shard_of(ue, self._count) == self._shard)
            columns = {name: np.concatenate([c[name] for c in rows]) for name in _common(rows)}
            if columns:
                mine = shard_of(columns["ue"], self._count) == self._shard
                columns = {name: column[mine] for name, column in columns.items()}
            processor.restore(snapshot, columns)
        except ValueError as error:
            log.error("the snapshots of %d workers do not fit: %s", count, error)
            return None
        done = Done(
            round=max(one.round for one in found),
            applied=highest(rule for one in found for rule in one.applied),
            mark=min((one.mark for one in found), key=lambda mark: mark.frame),
        )
        if self._shard == 0:  # whose frames they were is no longer known: they are counted here
            done.estimated = sum(one.estimated for one in found)
            for one in found:
                done.rejected.merge(one.rejected.as_dict())
        log.info("worker %d: %d UEs from the snapshots of %d workers", self._shard, processor.ues, count)
        return done

    def begin(self, processor: BlockProcessor, done: Done) -> None:
        """Write a snapshot of this moment in a process of its own, so that estimates go on meanwhile."""
        assert self._folder is not None
        worker = os.getpid()
        self._reason, reason = os.pipe()
        self._writer = os.fork()
        if self._writer == 0:
            code = UNKNOWN_ERROR
            try:
                code = self._write(processor, done, worker, reason)
            finally:
                os._exit(code)  # nothing of the worker's may run here
        os.close(reason)

    def wait(self) -> str | None:
        """Look whether the snapshot is written, without waiting; gives why it could not be.

        Once there is nothing to wait for, `writing` is False.
        """
        assert self._writer is not None
        pid, status = os.waitpid(self._writer, os.WNOHANG)
        if not pid:
            return None
        self._writer = None
        reason = os.read(self._reason, REASON_BYTES).decode(errors="replace")
        os.close(self._reason)
        code = os.waitstatus_to_exitcode(status)
        if code == 0:
            return None
        return reason or f"its writer ended with {code}"

    def _write(self, processor: BlockProcessor, done: Done, worker: int, reason: int) -> int:
        """In the process that writes; gives its exit status, and writes down why it could not.

        A worker that has died meanwhile has a successor, which goes on from the snapshot before: numbers of
        blocks mean something else from there on, so this one must not appear.
        """
        try:
            assert self._folder is not None
            os.nice(5)
            series = worker_series(self._folder, self._shard, self._count, self._durable)
            series.write(done.facts(), _members(processor), lambda: os.getppid() == worker)
            return 0
        except OSError as error:
            os.write(reason, (error.strerror or str(error)).encode()[:REASON_BYTES])
            return UNKNOWN_ERROR


def _members(processor: BlockProcessor) -> Iterator[tuple[str, NDArray[Any]]]:
    """The estimator's state in pieces, so that there is never a second copy of it all, and the rows."""
    for number, piece in enumerate(processor.pieces(PIECE_UES)):
        for name, array in piece.items():
            yield f"{number}/{name}", np.asarray(array)
    if (rows := processor.rows()) is not None:
        for name, column in rows.columns.items():
            yield f"{ROWS_NAME}/{name}", column


def _read(arrays: dict[str, NDArray[Any]]) -> tuple[Snapshot, dict[str, NDArray[Any]]]:
    """The estimator's state, and the columns of its rows."""
    parts: dict[str, Snapshot] = {}
    for member, array in arrays.items():
        part, _, name = member.partition("/")
        parts.setdefault(part, {})[name] = array
    rows = parts.pop(ROWS_NAME, {})
    return joined([parts[number] for number in sorted(parts, key=int)]), rows


def _common(rows: list[dict[str, NDArray[Any]]]) -> list[str]:
    return [name for name in rows[0] if all(name in columns for columns in rows)] if rows else []
