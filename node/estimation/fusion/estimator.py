"""Blocks of several arrays in, fused and tracked positions out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import Delay
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import FUSION
from chachart.node.data.placement import Placement, placed_arrays
from chachart.node.estimation.fusion.area import Area
from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.fusion.events import Events, Gathering
from chachart.node.estimation.fusion.fuser import Clock, Fuser
from chachart.node.estimation.fusion.looks import Looks
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.fusion.receiver import Receiver, usable
from chachart.node.estimation.fusion.sighted import sightings, single_sightings
from chachart.node.estimation.fusion.single import SingleArray
from chachart.node.estimation.fusion.watch import ArrayWatch
from chachart.node.estimation.locator import Locator
from chachart.node.estimation.memory import Copy, Memory
from chachart.node.estimation.options import Options
from chachart.node.estimation.snapshots import SEEN, counted, joined
from chachart.node.estimation.state import ROWS, Slots, SlotState, Snapshot
from chachart.node.estimation.tracking.smoother import Logbook
from chachart.node.estimation.tracking.tracker import Tracked, Tracker

METHOD: Final = Method(FUSION, FUSION)
ECHOES_SHARE = 0.25
"""Part of a fused position's covariance that stays however many follow: echoes shift them all alike."""


class FusedEstimator:
    """Locates UEs from the frames of several arrays, and follows them.

    Parameters
    ----------
    arrays
        The arrays, each with a name of its own.
    fusion, tracking
        See there.
    options
        What counts of them: `max_ues`, `forget_after_s`, and `delay`: whether UEs share the arrays'
        clock.
    placements
        Where arrays really are, and what their clocks are late: taken off.

    Attributes
    ----------
    rejected
        Frames that were not used, by reason: `shape`, `zero`, `not_finite`, `out_of_range`, `unknown_array`.
    heard
        Frames that were used, by array.
    logbook
        Gets every state of every track, where there is one.
    receivers, witness
        The arrays as fusion sees them, and who is told of all transmissions and their origins, row by row.

    Raises
    ------
    ValueError
        If an array, an option or a placement does not fit.
    """

    def __init__(
        self,
        arrays: Sequence[ArrayGeometry],
        fusion: FusionOptions | None = None,
        tracking: TrackingOptions | None = None,
        options: Options | None = None,
        placements: Sequence[Placement] = (),
    ) -> None:
        self.arrays = placed_arrays(arrays, placements)
        self.fusion, self.tracking = fusion or FusionOptions(), tracking or TrackingOptions()
        self._number = {array.name: i for i, array in enumerate(self.arrays)}
        if len(self._number) < len(self.arrays):
            raise ValueError(f"arrays must have different names, not {[a.name for a in self.arrays]}")
        known = {one.name: one for one in placements}
        places = [known.get(array.name, Placement(array.name)) for array in self.arrays]
        on_time = [place.on_time(array) for place, array in zip(places, self.arrays, strict=True)]
        self.receivers = [Receiver(array) for array in on_time]
        sites = [receiver.site for receiver in self.receivers]
        self.options = options or Options()
        if self.fusion.clock == "shared" and self.options.delay == "relative":
            raise ValueError(
                'clock must be "own" or "offset": delays of these captures are of packet detection'
            )
        self.clock = (
            clock_of(self.arrays, self.options.delay) if self.fusion.clock == "auto" else self.fusion.clock
        )
        self._ground = self._area()
        alone = on_time[0]
        self._fuser: Fuser | SingleArray = (
            SingleArray(alone, self._ground.height_m)
            if len(self.arrays) == 1
            else Fuser(sites, self._ground, self.clock)
        )
        shapes = [receiver.shape for receiver in self.receivers]
        if len(self.arrays) == 1:
            shapes = [(alone.antennas, alone.subcarriers)]
        self._gathering = Gathering(shapes, self.fusion.window_ms, self._frames_a_position())
        self._memory, self._tracker = self._remembering()
        self._looks, self._watch = Looks(sites, self.arrays), ArrayWatch(sites, self.clock, places)
        self.rejected, self.heard = Counters(), Counters()
        self.logbook: Logbook | None = None
        self.witness: Callable[[Events, Fused], None] | None = None

    @property
    def method(self) -> Method:
        """What rows say of how they were made."""
        return METHOD

    @property
    def ues(self) -> int:
        """How many UEs are known."""
        return len(self._memory.table)

    @property
    def tracker(self) -> Tracker | None:
        """What follows UEs, if anything does."""
        return self._tracker

    def update(self, block: CsiBlock) -> ChartUpdate:
        """Take the frames of one array; one row for each UE with a transmission that is complete now.

        A transmission is complete when all arrays have received it, or when one that has not could no longer.
        """
        return self.newest(self.every(block))

    def update_all(self, blocks: Sequence[CsiBlock]) -> ChartUpdate:
        """As `update`, of blocks of several arrays: what they complete is located at once."""
        for block in blocks:
            self._take(block)
        return self.newest(self._every())

    def flush(self) -> ChartUpdate:
        """Rows of what still waits for arrays: no frame comes any more."""
        return self.newest(self._every(everything=True))

    def every(self, block: CsiBlock | None) -> list[ChartUpdate]:
        """As `update`, but all rows of a UE: one update for each of its transmissions; None flushes."""
        if block is not None:
            self._take(block)
        return list(self._every(everything=block is None))

    def _take(self, block: CsiBlock) -> None:
        """Put the good frames of a block to those that wait."""
        if (number := self._number.get(block.array)) is None:
            self.rejected.add("unknown_array", len(block))
            return
        receiver = self.receivers[number]
        if block.csi.shape[1:] != (receiver.array.antennas, receiver.array.subcarriers):
            self.rejected.add("shape", len(block))
            return
        good = usable(block, self.rejected)
        if good is None:
            return
        self.heard.add(block.array, len(good))
        csi = good.csi if len(self.arrays) == 1 else receiver.prepared(good.csi)
        self._gathering.add(number, replace(good, csi=csi))

    def newest(self, updates: Sequence[ChartUpdate] | Iterator[ChartUpdate]) -> ChartUpdate:
        """The last row of each UE."""
        return (
            ChartUpdate.concatenate(found) if (found := [u for u in updates if len(u)]) else self._nothing()
        )

    def forget(self, now_ns: int) -> NDArray[np.uint64]:
        """As `ChartEstimator.forget`."""
        if self.options.forget_after_s is None:
            return np.zeros(0, np.uint64)
        table = self._memory.table
        slots = table.unseen_since(now_ns - round(self.options.forget_after_s * 1e9))
        gone = table.ues(slots)
        table.remove(slots)
        self._looks.remove(gone)
        return gone

    def set_method(self, theta: str, rho: str) -> None:
        """Nothing: fusion has one method, whatever single arrays are charted with."""

    def spectrum(self, ue: int) -> dict[str, Any] | None:
        """What each array says of a UE, see `Looks.spectrum`; None where it is not known."""
        return self._looks.spectrum(ue)

    def array_report(self) -> list[dict[str, Any]]:
        """How each array does, see `ArrayWatch.report`."""
        return self._watch.report()

    def copy(self) -> Copy:
        """As `ChartEstimator.copy`: of all tracks, and the frames that wait for other arrays."""
        beside = {
            "method": np.array([METHOD.theta, METHOD.rho]),
            "known": self._memory.table.ues(self._memory.table.slots),
        }
        return self._memory.copy(
            touched=False, beside=beside | self._gathering.waiting() | counted(self.rejected.as_dict())
        )

    def restore(self, snapshot: Snapshot) -> None:
        """As `ChartEstimator.restore`.

        Raises
        ------
        ValueError
            If the snapshot is of other options; nothing has changed then.
        """
        snapshot = joined([snapshot])
        if snapshot["method"].tolist() != [METHOD.theta, METHOD.rho]:
            raise ValueError("the snapshot is of one array, not of fused ones")
        rows = {name: values for name, values in snapshot.items() if name.endswith(ROWS)}
        newest = np.sort(np.argsort(rows[SEEN], kind="stable")[-self.options.max_ues :])
        memory, tracker = self._remembering()
        memory.restore(snapshot | {name: values[newest] for name, values in rows.items()})
        self._memory.give_up_copy()
        self._memory, self._tracker = memory, tracker
        self._gathering.restore(snapshot)
        self.rejected = Counters()
        reasons, counts = snapshot["rejected.reasons"], snapshot["rejected.counts"]
        self.rejected.merge({str(r): int(n) for r, n in zip(reasons, counts, strict=True)})

    def _remembering(self) -> tuple[Memory, Tracker | None]:
        motion = self.tracking.motion
        tracker = None if motion == "off" else Tracker(motion, self.tracking.lag)
        return Memory(self.options.max_ues, cast(Locator, tracker or SlotState())), tracker

    def _frames_a_position(self) -> int:
        """Frames of one array that an estimate takes; unless set, averaging is the tracker's business."""
        alone = len(self.arrays) == 1 and "memory_frames" in self.options.model_fields_set
        return max(1, round(self.options.memory_frames)) if alone else 1

    def _area(self) -> Area:
        told = self.fusion
        first = self.arrays[0]
        height = told.height_m
        if height is None:
            height = 0.0 if first.height_m is None else float(first.centre_m[2]) - first.height_m
        level = None if height == "free" else float(height)
        outline = told.outline_m
        box = told.area_m
        if box is None and outline is not None:
            x, y = zip(*outline, strict=True)
            box = (min(x), min(y), max(x), max(y))
        if box is None:
            around = Area.around([receiver.site for receiver in self.receivers], level)
            box = (*around.low, *around.high)
        return Area(box[:2], box[2:], level, told.slope, told.heights_m, outline)

    def _every(self, everything: bool = False) -> Iterator[ChartUpdate]:
        """Updates of one transmission a UE each."""
        events = self._gathering.ready(everything)
        if events is None:
            return
        turn = _turns(events.ue)
        for i in range(int(turn.max()) + 1):
            now = events.take(turn == i)
            most = self.options.max_ues
            for start in range(0, len(now), most):
                part = np.zeros(len(now), np.bool_)
                part[start : start + most] = True
                yield self._row(now.take(part))

    def _row(self, events: Events) -> ChartUpdate:
        slots = self._memory.assign(events.ue, events.time_ns).slots
        near = None if self._tracker is None else self._near(slots, events.time_ns)
        fused = self._fuser.locate(events.frames, near)
        shown = events
        if len(self.arrays) == 1:
            shown = replace(events, frames=[self.receivers[0].prepared(events.frames[0])])
        self._looks.see(shown, fused)
        self._watch.see(shown, fused)
        if self.witness is not None:
            self.witness(shown, fused)
        if self._tracker is None:
            return self._published(events, fused, None)
        seen = sightings(fused) if len(self.arrays) > 1 else single_sightings(fused)
        tracked = self._tracker.update(slots, events.time_ns, seen)
        if self.logbook is not None:
            models = self._tracker.models(slots)
            self.logbook.add(events.ue, tracked.time_ns, tracked.state, tracked.covariance, models)
        return self._published(events, fused, tracked)

    def _near(self, slots: Slots, time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Where the tracks say that UEs are, as points (U, 1, 3) to search from."""
        assert self._tracker is not None
        place = self._tracker.expected(slots, time_ns)
        return np.column_stack([place, self._ground.height(place)])[:, None]

    def _published(self, events: Events, fused: Fused, tracked: Tracked | None) -> ChartUpdate:
        position, covariance = fused.position, fused.covariance
        time_ns, speed = events.time_ns, None
        if tracked is not None:
            around = ECHOES_SHARE * covariance
            around[:, :2, :2] += tracked.covariance[:, :2, :2]
            position, covariance = np.column_stack([tracked.state[:, :2], position[:, 2]]), around
            speed, time_ns = tracked.state[:, 2:], tracked.time_ns
        theta, rho = self.arrays[0].theta_rho(position)
        best = np.clip(fused.purity, 1e-6, 1 - 1e-6)
        return ChartUpdate(
            self.fusion.name,
            METHOD,
            events.ue,
            time_ns,
            theta=theta,
            rho=rho,
            x=position[:, 0],
            y=position[:, 1],
            z=position[:, 2],
            x_var=covariance[:, 0, 0],
            xy_cov=covariance[:, 0, 1],
            y_var=covariance[:, 1, 1],
            z_var=covariance[:, 2, 2],
            vx=None if speed is None else speed[:, 0],
            vy=None if speed is None else speed[:, 1],
            snr=10 * np.log10(best / (1 - best)),
            snapshots=events.count.astype(np.float64),
            arrays=fused.arrays,
            outlier=fused.outlier,
            position=events.position,
        )

    def _nothing(self) -> ChartUpdate:
        needed = {column.name: column.missing(0) for column in COLUMNS.values() if not column.optional}
        return ChartUpdate(self.fusion.name, METHOD, **needed)


def clock_of(arrays: Sequence[ArrayGeometry], delay: Delay) -> Clock:
    """What the arrays' descriptions and a capture's facts say of clocks."""
    names = {array.clock for array in arrays}
    together = len(names) == 1 and (None not in names) and all(a.clock_shares == "time" for a in arrays)
    if len(arrays) == 1 or together:
        return "shared" if delay == "absolute" else "offset"
    return "own"


def _turns(ue: NDArray[Any]) -> NDArray[np.intp]:
    """How many entries of the same UE come before each, where those of a UE stand together."""
    starts = np.flatnonzero(np.concatenate([[True], ue[1:] != ue[:-1]]))
    lengths = np.diff(np.append(starts, len(ue)))
    return np.arange(len(ue)) - np.repeat(starts, lengths)
