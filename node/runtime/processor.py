"""What a worker does with a block. No socket in here: it runs inline as well as in a process of its own."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.placement import Placement
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.fusion.path_lists import PathLists
from chachart.node.estimation.options import Options
from chachart.node.estimation.state import Snapshot
from chachart.node.runtime.table import ChartTable

log = logging.getLogger(__name__)

GATHERED_ROWS = 4096
FORGETS_PER_PERIOD = 10
"""How often per `forget_after_s` unseen UEs are looked for."""


class FrameClock:
    """The time of the newest frame; where `live`, it goes on at the host's pace while none come.

    Parameters
    ----------
    live
        False for recordings: their time is that of their frames, however fast they are replayed.
    monotonic
        The host's clock, in seconds.
    """

    def __init__(self, live: bool, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.live = live
        self._monotonic = monotonic
        self._newest_ns: int | None = None
        self._seen = 0.0

    def see(self, newest_ns: int) -> None:
        """A frame of that time came in."""
        if self._newest_ns is None or newest_ns >= self._newest_ns:
            self._newest_ns, self._seen = newest_ns, self._monotonic()

    def start_over(self) -> None:
        """No frame has come in yet: time may go back."""
        self._newest_ns = None

    def now_ns(self) -> int | None:
        """The time, or None before the first frame."""
        if self._newest_ns is None or not self.live:
            return self._newest_ns
        return self._newest_ns + int((self._monotonic() - self._seen) * 1e9)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What became of a block: its update, if any frame could be estimated, and what was dropped."""

    update: ChartUpdate | None
    estimated: int
    dropped: dict[str, int]


class LatestRows:
    """The newest row of each UE; rows are gathered, since to put many in their places at once is cheap."""

    def __init__(self, max_ues: int) -> None:
        self._table = ChartTable(max_ues)
        self._gathered: list[ChartUpdate] = []
        self._count = 0

    def add(self, update: ChartUpdate) -> None:
        """Newer rows."""
        self._gathered.append(update)
        self._count += len(update)
        if self._count >= GATHERED_ROWS:
            self._put_away()

    def remove(self, ue: NDArray[np.uint64]) -> None:
        """These UEs are forgotten."""
        if len(ue):
            self._put_away()
            self._table.remove(ue)

    def all(self) -> ChartUpdate | None:
        """All of them, or None if there is none."""
        self._put_away()
        return self._table.chart()

    def _put_away(self) -> None:
        if self._gathered:
            self._table.update(ChartUpdate.concatenate(self._gathered))
            self._gathered, self._count = [], 0


class BlockProcessor:
    """Blocks of one shard in, chart updates out.

    Parameters
    ----------
    array, estimator
        The array, and ChartEstimator's other arguments (the fields of Options).
    clock
        What tells when UEs have been unseen for too long.
    several
        What else fusion and tracking need, see `Plan.several`; None: the array is charted on its own.

    Attributes
    ----------
    untrained
        Rows held back because a method that must be trained was not, so far.
    """

    def __init__(
        self,
        array: ArrayGeometry,
        estimator: Mapping[str, Any],
        clock: FrameClock,
        several: Mapping[str, Any] | None = None,
    ) -> None:
        self._estimator = estimator_of(array, estimator, several)
        lists = several is None and self._estimator.options.path_list
        self._path_lists = PathLists(array) if lists else None
        self._name = several["fusion"]["name"] if several else array.name
        self._forget_after_ns = int((estimator.get("forget_after_s") or 0) * 1e9)
        self._next_forget_ns: int | None = None
        self._rejected: dict[str, int] = {}
        self._rows = LatestRows(self._estimator.options.max_ues)
        self.clock = clock
        self.untrained = 0

    @property
    def ues(self) -> int:
        """UEs that the estimator holds."""
        return self._estimator.ues

    def process(self, block: CsiBlock, theta: str, rho: str) -> Outcome:
        """Estimate with these methods: one row for each UE of which a frame could be used."""
        return self.process_all([block], theta, rho)

    def process_all(self, blocks: Sequence[CsiBlock], theta: str, rho: str) -> Outcome:
        """As `process`, of blocks of which those of one array follow each other."""
        frames = sum(map(len, blocks))
        self.clock.see(max(int(block.time_ns.max()) for block in blocks))
        try:
            self.set_method(theta, rho)
            runs = [CsiBlock.concatenate(list(run)) for _, run in groupby(blocks, lambda block: block.array)]
            if isinstance(self._estimator, FusedEstimator):
                update = self._estimator.update_all(runs)
            else:
                (block,) = runs
                update = self._estimator.update(block)
                if self._path_lists is not None:
                    update = self._path_lists.told(update, block)
        except Exception:
            log.exception("a block of %d frames could not be estimated", frames)
            dropped = self._newly_rejected()
            dropped["estimation_failed"] = frames - sum(dropped.values())
            return Outcome(None, 0, dropped)
        dropped = self._newly_rejected()
        if untrained := dropped.pop("untrained", 0):
            if not self.untrained:
                log.warning('rho = "lr" keeps UEs off the chart until it has seen two with a known position')
            self.untrained += untrained
        if len(update):
            self._rows.add(update)
        return Outcome(update if len(update) else None, frames - sum(dropped.values()), dropped)

    def start_over(self) -> None:
        """Let go of all UEs: the source has jumped in time."""
        self._estimator.forget(np.iinfo(np.int64).max)
        self._next_forget_ns = None
        self.clock.start_over()
        self._rows = LatestRows(self._estimator.options.max_ues)

    def pieces(self, ues: int) -> Iterator[Snapshot]:
        """The estimator's state, of at most so many UEs at a time."""
        copy = self._estimator.copy()
        while (piece := copy.piece(ues)) is not None:
            yield piece

    def rows(self) -> ChartUpdate | None:
        """The newest row of each UE, or None if there is none."""
        return self._rows.all()

    def restore(self, snapshot: Snapshot, rows: Mapping[str, NDArray[Any]]) -> None:
        """Go on from there.

        Parameters
        ----------
        snapshot
            The estimator's.
        rows
            The columns of the newest row of each UE.

        Raises
        ------
        ValueError
            If the snapshot is of another array or of other options; nothing has changed then.
        """
        self._estimator.restore(snapshot)
        self._rejected = self._estimator.rejected.as_dict()
        self._rows = LatestRows(self._estimator.options.max_ues)
        if len(rows.get("ue", ())):
            update = ChartUpdate(self._name, self._estimator.method, **rows)
            self._rows.add(update)
            self.clock.see(int(update.time_ns.max()))

    def forget(self) -> None:
        """Let go of UEs unseen for too long; cheap to call often."""
        now_ns = self.clock.now_ns()
        if not self._forget_after_ns or now_ns is None:
            return
        if self._next_forget_ns is None or now_ns >= self._next_forget_ns:
            self._rows.remove(self._estimator.forget(now_ns))
            self._next_forget_ns = now_ns + self._forget_after_ns // FORGETS_PER_PERIOD

    def _newly_rejected(self) -> dict[str, int]:
        before, self._rejected = self._rejected, self._estimator.rejected.as_dict()
        new = {reason: n - before.get(reason, 0) for reason, n in self._rejected.items()}
        return {reason: n for reason, n in new.items() if n}

    def set_method(self, theta: str, rho: str) -> None:
        """Estimate with these methods from now on, if it is not what is done already.

        Raises
        ------
        ValueError
            If they do not fit; nothing has changed then.
        """
        if self._estimator.method != Method(theta, rho):
            self._estimator.set_method(theta, rho)

    def array_report(self) -> list[dict[str, Any]]:
        """How each of several arrays does; nothing of one that is charted on its own."""
        fused = self._estimator
        return fused.array_report() if isinstance(fused, FusedEstimator) else []

    def answer(self, operation: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a request about one of the UEs that are here.

        Raises
        ------
        RequestError
            If there is no such operation, or it cannot be carried out.
        """
        if operation == "spectrum":
            return self.spectrum(arguments["ue"])
        raise RequestError(f"a worker knows no operation {operation!r}")

    def spectrum(self, ue: int) -> dict[str, Any]:
        """See `NodeAccess`.

        Raises
        ------
        RequestError
            If the UE is not on the chart.
        """
        spectrum = self._estimator.spectrum(ue)
        if spectrum is None:
            raise RequestError(f"UE {ue} is not on the chart")
        return {key: _plain(value) for key, value in spectrum.items()}


def estimator_of(
    array: ArrayGeometry, estimator: Mapping[str, Any], several: Mapping[str, Any] | None
) -> ChartEstimator | FusedEstimator:
    """The estimator of an array on its own, or of it and others.

    Raises
    ------
    ValueError
        If something does not fit.
    """
    if several is None:
        return ChartEstimator(array, **estimator)
    arrays = [array, *(ArrayGeometry.from_dict(other) for other in several["others"])]
    fusion = FusionOptions.model_validate_json(json.dumps(several["fusion"]))
    tracking = TrackingOptions.model_validate(several["tracking"])
    placements = [Placement(**place) for place in several["placements"]]
    return FusedEstimator(arrays, fusion, tracking, Options.of(**estimator), placements)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
