"""Blocks of CSI in, chart updates out: the estimators as a plain library."""

from __future__ import annotations

import dataclasses
from typing import Any, Unpack, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.auto import AutoLocator
from chachart.node.estimation.covariance import Grouping
from chachart.node.estimation.directions.joint import DirectionLocator
from chachart.node.estimation.fit import misfits
from chachart.node.estimation.joint import JointLocator
from chachart.node.estimation.locator import Columns, Locator
from chachart.node.estimation.memory import Copy, Memory
from chachart.node.estimation.options import AUTO, JOINT, NONE, Keywords, Options
from chachart.node.estimation.separate import SeparateLocator
from chachart.node.estimation.snapshots import SEEN, counted, joined
from chachart.node.estimation.state import ROWS, Snapshot

SPECTRUM_POINTS = 512
LEAST_ENERGY, MOST_ENERGY = 1e-28, 1e28
"""Sum of |h|^2 of a frame that single precision can work with: covariances are multiplied with each other."""


class ChartEstimator:
    """Estimates theta and rho of every UE of one array from all of its frames so far.

    Parameters
    ----------
    array
        The array whose frames come in; its calibration, where it has one, is applied to them.
    facts
        What the capture says of phase and delay, as `RecordingReader.facts`: where it says that delays are of
        packet detection, methods that take them for distances are refused.
    options
        See `Options` for names, defaults and meaning.

    Attributes
    ----------
    rejected
        Frames that were not used, and rows that could not be published, by reason: `shape` (not antennas x
        subcarriers), `zero` (all of it), `not_finite`, `out_of_range` (too large or too small for single
        precision), `no_estimate` (frames that stay in the average, but the method finds no direction in it,
        as MVDR without loading where it cannot be inverted), `untrained` (rows without a range: rho = "lr"
        before two UEs with a position were seen), `above_plane` (rows of directions without a range that do
        not meet the plane of the UEs).

    Raises
    ------
    ValueError
        If an option's value makes no sense or does not fit the array; the message begins with its name.
    TypeError
        If an option is unknown.

    Examples
    --------
    >>> array = ArrayGeometry("lab", 8, 4, 2e9, 1e6, 0.075)
    >>> estimator = ChartEstimator(array, theta="bartlett", rho="music")
    >>> n, s = np.arange(8)[:, None], np.arange(4)
    >>> csi = np.exp(1j * (array.theta_phase * np.cos(1.0) * n + array.rho_phase * 50.0 * s))
    >>> update = estimator.update(csi, ue=1)
    >>> round(float(update.rho[0]), 2)
    50.0
    """

    def __init__(
        self, array: ArrayGeometry, facts: CaptureFacts | None = None, **options: Unpack[Keywords]
    ) -> None:
        self.array = array
        self.options = Options.of(**options).obeying(facts or CaptureFacts())
        self.rejected = Counters()
        self._memory = Memory(self.options.max_ues, self._make_locator(self.options))
        self._correct = None if array.calibration is None else array.calibration.corrector(array.offsets_hz)
        live = array.live_antennas, array.live_tones
        self._live = None if all(mask.all() for mask in live) else np.ix_(*map(np.flatnonzero, live))

    @property
    def method(self) -> Method:
        """The methods in use."""
        return Method(self.options.theta, self.options.rho)

    @property
    def ues(self) -> int:
        """How many UEs are known."""
        return len(self._memory.table)

    @property
    def bytes_per_ue(self) -> int:
        """Memory that is kept of a UE: `max_ues` times as much is what this may grow to."""
        return self._memory.bytes_per_slot

    def set_method(self, theta: str, rho: str) -> None:
        """Go on with other methods; their averages start afresh.

        Raises
        ------
        ValueError
            If a method is unknown or does not fit the array; the estimator then goes on as before.
        """
        options = self._with_method(theta, rho)
        self._memory.replace_locator(self._make_locator(options))
        self.options = options

    @overload
    def update(self, frames: CsiBlock) -> ChartUpdate: ...

    @overload
    def update(
        self,
        frames: ArrayLike,
        *,
        ue: ArrayLike,
        time_ns: ArrayLike | None = None,
        position: ArrayLike | None = None,
    ) -> ChartUpdate: ...

    def update(
        self,
        frames: CsiBlock | ArrayLike,
        *,
        ue: ArrayLike | None = None,
        time_ns: ArrayLike | None = None,
        position: ArrayLike | None = None,
    ) -> ChartUpdate:
        """Take frames; returns one row per UE of them, in order of first appearance.

        Frames that carry nothing or nonsense are counted in `rejected` and not used; a UE of which no frame
        is left has no row. A block of more frames than `max_ues` is taken in pieces; a UE then has the row of
        its last piece, in that place.

        Parameters
        ----------
        frames
            A block, or plain CSI (K, N_R, N_S) with its UEs and, where known, times and positions: see
            `CsiBlock.of`.

        Raises
        ------
        ValueError, TypeError
            If plain arrays do not go together, or `ue` is missing, or given beside a block.
        """
        if isinstance(frames, CsiBlock):
            if not (ue is None and time_ns is None and position is None):
                raise TypeError("ue, time_ns and position go with plain arrays: a block has its own")
            return self._update(frames)
        if ue is None:
            raise TypeError("ue must say whose frames these are")
        return self._update(CsiBlock.of(frames, ue, time_ns, position, array=self.array.name))

    def _update(self, block: CsiBlock) -> ChartUpdate:
        if len(block) > self.options.max_ues:
            starts = np.arange(self.options.max_ues, len(block), self.options.max_ues)
            pieces = np.split(np.arange(len(block)), starts)
            return ChartUpdate.concatenate([self._update(block.take(piece)) for piece in pieces])
        if block.csi.shape[1:] != (self.array.antennas, self.array.subcarriers):
            self.rejected.add("shape", len(block))
            return self._nothing()
        with np.errstate(all="ignore"):
            block = self._prepared(block)
            features = self._memory.locator.features(block.csi)
            energy = features.energy
        good = (energy > LEAST_ENERGY) & (energy < MOST_ENERGY)
        if not good.all():
            self._count_rejected(energy[~good])
            if not good.any():
                return self._nothing()
            block, features = block.take(good), features.take(good)
        group = Grouping(self._memory.assign(block.ue, block.time_ns).slots)
        time_ns = np.maximum.reduceat(block.time_ns[group.order], group.starts)
        told, lasting = self._memory.positions(block, group, time_ns)
        with np.errstate(divide="ignore", invalid="ignore"):  # NaN is for those without an estimate
            located = self._memory.locator.estimate(group, features, told)
        return self._published(block, group, located, time_ns, lasting)

    def _prepared(self, block: CsiBlock) -> CsiBlock:
        """Frames as they would be from a perfect array, without what does not count."""
        csi = block.csi if self._correct is None else self._correct(block.csi)
        if self._live is not None:
            csi = np.ascontiguousarray(csi[:, self._live[0], self._live[1]])
        return block if csi is block.csi else dataclasses.replace(block, csi=csi)

    def forget(self, now_ns: int) -> NDArray[np.uint64]:
        """Drop the UEs unseen for `forget_after_s` at `now_ns`; returns them."""
        if self.options.forget_after_s is None:
            return np.zeros(0, np.uint64)
        before_ns = now_ns - round(self.options.forget_after_s * 1e9)
        table = self._memory.table
        slots = table.unseen_since(before_ns)
        gone = table.ues(slots)
        table.remove(slots)
        return gone

    def snapshot(self) -> Snapshot:
        """Everything that is known: `restore` goes on from there, here or in another estimator.

        See `copy` for one that is taken piece by piece, and `chachart.node.estimation.snapshots` for several
        joined, merged or split up.
        """
        copy = self.copy()
        pieces = []
        while (piece := copy.piece(max(copy.ues, 1))) is not None:
            pieces.append(piece)
        return joined(pieces)

    def copy(self, *, touched: bool = False) -> Copy:
        """A copy of this moment that is taken in pieces, so that estimates need not wait for it.

        Parameters
        ----------
        touched
            Only the UEs that had a frame since the last copy, of either kind, was begun. A change of method
            touches all.
        """
        beside = {
            "method": np.array([self.options.theta, self.options.rho]),
            "known": self._memory.table.ues(self._memory.table.slots),
        }
        return self._memory.copy(touched=touched, beside=beside | counted(self.rejected.as_dict()))

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot, forgetting everything else; its method goes on, too.

        Of more UEs than `max_ues` the longest unseen are left out.

        Raises
        ------
        ValueError
            If the snapshot is of another array or other options; nothing has changed then.
        """
        snapshot = joined([snapshot])
        options = self._with_method(*map(str, snapshot["method"]))
        rows = {name: values for name, values in snapshot.items() if name.endswith(ROWS)}
        newest = np.sort(np.argsort(rows[SEEN], kind="stable")[-options.max_ues :])
        memory = Memory(options.max_ues, self._make_locator(options))
        memory.restore(snapshot | {name: values[newest] for name, values in rows.items()})
        self._memory.give_up_copy()
        self._memory, self.options = memory, options
        self.rejected = Counters()
        reasons, counts = snapshot["rejected.reasons"], snapshot["rejected.counts"]
        self.rejected.merge({str(r): int(n) for r, n in zip(reasons, counts, strict=True)})

    def spectrum(self, ue: int) -> dict[str, Any] | None:
        """The spectra behind a UE's estimate (largest value 1); None if the UE has none.

        Keys `theta_grid_rad`, `theta_spectrum`, `theta`, `rho`, `theta_std`, `rho_std` and, where a spectral
        method gives the range, `rho_grid_m` and `rho_spectrum`.
        """
        if not 0 <= ue < 2**64:
            return None
        slot = int(self._memory.table.lookup(np.array([ue], np.uint64))[0])
        if slot < 0 or np.isnan(self._memory.latest["theta"].rows[slot]):
            return None
        found = self._memory.locator.spectrum(slot, SPECTRUM_POINTS)
        if found is None:
            return None
        return found | {name: float(kept.rows[slot]) for name, kept in self._memory.latest.items()}

    def _make_locator(self, options: Options) -> Locator:
        for name, problem in misfits(options, self.array):
            raise ValueError(f"{name} {problem}")
        make: type[AutoLocator | JointLocator | DirectionLocator | SeparateLocator] = SeparateLocator
        if options.rho == AUTO:
            make = AutoLocator
        elif options.theta == JOINT:
            make = JointLocator if self.array.is_uniform else DirectionLocator
        return make(self.array, options)

    def _with_method(self, theta: str, rho: str) -> Options:
        return Options.of(**cast(Keywords, {**self.options.keywords(), "theta": theta, "rho": rho}))

    def _count_rejected(self, energy: NDArray[Any]) -> None:
        for reason, which in (
            ("zero", energy == 0),
            ("not_finite", ~np.isfinite(energy)),
            ("out_of_range", np.isfinite(energy) & (energy != 0)),
        ):
            if which.any():
                self.rejected.add(reason, int(which.sum()))

    def _published(
        self,
        block: CsiBlock,
        group: Grouping,
        at: Columns,
        time_ns: NDArray[np.int64],
        position: NDArray[np.float32],
    ) -> ChartUpdate:
        for name, kept in self._memory.latest.items():
            kept.rows[group.slots] = at[name]
        x, y = self._chart_xy(at)
        update = ChartUpdate(
            block.array,
            self.method,
            self._memory.table.ues(group.slots),
            time_ns,
            x=x,
            y=y,
            position=position,
            **{name: values for name, values in at.items() if name in COLUMNS},
        )
        found = np.isfinite(at["theta"])
        trained = found & np.isfinite(at["rho"])
        good = trained & np.isfinite(x)
        if good.all():
            return update
        if lost := int(group.counts[~found].sum()):
            self.rejected.add("no_estimate", lost)
        if untrained := int((found & ~trained).sum()):
            self.rejected.add("untrained", untrained)
        if unmet := int((trained & ~good).sum()):
            self.rejected.add("above_plane", unmet)
        return update.take(good)

    def _chart_xy(self, at: Columns) -> tuple[NDArray[Any], NDArray[Any]]:
        """Chart coordinates; of arrays that are no line world metres, and z among the columns.

        Distances without a scale are neither projected nor have they a place in the world. Directions alone
        lie on a circle of radius 1, or where they meet the plane of the UEs.
        """
        theta, rho, line = at["theta"], at["rho"], self.array.is_line or "direction" not in at
        alone = self.options.rho == NONE
        if not line and alone and self.array.height_m is not None and "elevation" in at:
            rho = np.full(len(rho), np.nan)
            del at["relative"]
        elif "relative" in at and line:
            return rho * np.sin(theta), rho * np.cos(theta)
        elif "relative" in at:
            x, y = (at["direction"] @ self.array.frame[:, :2]).T * rho
            return x, y
        if line:
            return self.array.chart_xy(theta, rho)
        x, y, at["z"] = self.array.world_of(at["direction"], rho).T
        return x, y

    def _nothing(self) -> ChartUpdate:
        needed = {column.name: column.missing(0) for column in COLUMNS.values() if not column.optional}
        return ChartUpdate(self.array.name, self.method, **needed)
