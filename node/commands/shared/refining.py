"""`chachart evaluate --refine`: UEs that nobody should trust go where UEs with channels like theirs are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.shared.cli import progress
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.certainty import Fused
from chachart.node.estimation.fusion.events import Events
from chachart.node.estimation.fusion.fuser import Clock
from chachart.node.estimation.fusion.receiver import Receiver
from chachart.node.estimation.fusion.site import Site
from chachart.node.estimation.quality import neighbourhoods
from chachart.node.estimation.refinement.doubts import covariances, outliers
from chachart.node.estimation.refinement.graph import graph
from chachart.node.estimation.refinement.profile import LENGTH, Profiler, Profiles
from chachart.node.estimation.refinement.refine import Refined, refine
from chachart.node.files.recording import RecordingReader

Floats = NDArray[np.float64]


class Witness:
    """Keeps profiles and rival places of transmissions, in the order in which they are located."""

    def __init__(self, sites: list[Site], clock: Clock) -> None:
        self._profiler = Profiler(sites, clock)
        self._profiles: list[Profiles] = []
        self._tops: list[Floats] = []
        self._scores: list[Floats] = []

    def __call__(self, events: Events, fused: Fused) -> None:
        """Take some that have been located."""
        self._profiles.append(self._profiler.of(events.frames))
        self._tops.append(fused.tops[:, :, :2])
        self._scores.append(fused.top_scores)

    def refined(self, place: Floats, outlier: Floats) -> Refined:
        """Fused positions (K, 2), each with its probability (K,) of being an outlier."""
        profiles = np.concatenate(self._profiles)
        tops, scores = np.concatenate(self._tops), np.concatenate(self._scores)
        return _of_finite(profiles, place, np.zeros((len(place), 2, 2)), outlier, tops, scores)


def refined(reader: RecordingReader, chart: ChartUpdate, array: ArrayGeometry) -> Refined:
    """The chart of one array, whose frames are read once more.

    Raises
    ------
    SetupError
        If its distances have no scale, or there are too few tones or UEs.
    """
    if (chart["relative"] == 1).any() or "none" in (chart.method.theta, chart.method.rho):
        raise SetupError("--refine needs directions and distances in metres")
    try:
        receiver = Receiver(array)
    except ValueError as error:
        raise SetupError(f"--refine: {error}") from None
    profiler = Profiler([receiver.site], "shared" if reader.facts.delay == "absolute" else "own")
    order = np.argsort(chart.ue)
    total = np.zeros((len(chart), LENGTH), np.float32)
    with progress("profiles", reader.summary().frames) as advance:
        for block in reader.blocks():
            frames = np.nan_to_num(receiver.prepared(block.csi))
            at = np.searchsorted(chart.ue[order], block.ue)
            known = chart.ue[order][np.minimum(at, len(chart) - 1)] == block.ue
            np.add.at(total, order[at[known]], profiler.of([frames])[known])
            advance(len(block))
    place = np.column_stack([chart.x, chart.y])
    return _of_finite(total, place, covariances(chart, array), outliers(chart))


def figures(refined: Refined, truth: Floats, k: int | None, exact_ues: int) -> dict[str, Any]:
    """Errors, TW and CT of refined positions of which the truth (K, 2), NaN where unknown, is known."""
    found: dict[str, Any] = {"positions": len(refined.place), "moved": int(refined.moved.sum())}
    known = np.isfinite(truth).all(axis=1) & np.isfinite(refined.place).all(axis=1)
    if known.sum() < 8:
        return found | {"error_m": None}
    there, place = truth[known], refined.place[known]
    error = np.linalg.norm(place - there, axis=1)
    sampled = np.random.default_rng(0) if len(error) > exact_ues else None
    near = neighbourhoods(there, place, k, rng=sampled)
    return found | {
        "error_m": float(np.median(error)),
        "error_mean_m": float(error.mean()),
        "error_p90_m": float(np.quantile(error, 0.9)),
        "tw": near.tw,
        "ct": near.ct,
        "k": near.k,
    }


def say(found: dict[str, Any]) -> None:
    """The figures in two lines, after those of the chart as it was estimated."""
    print(f"refined   {found['moved']} of {found['positions']} positions moved to channels like theirs")
    if found["error_m"] is not None:
        print(
            f"          {found['error_m']:.3f} m median, {found['error_mean_m']:.2f} m mean, "
            f"{found['error_p90_m']:.2f} m for 90 %; TW {found['tw']:.4f}, CT {found['ct']:.4f}"
        )


def _of_finite(
    profiles: Profiles,
    place: Floats,
    covariance: Floats,
    outlier: Floats,
    tops: Floats | None = None,
    scores: Floats | None = None,
) -> Refined:
    """What can be refined: positions that are known, of channels that were heard."""
    usable = np.isfinite(place).all(axis=1) & (np.abs(profiles).max(axis=1) > 0)
    parts = [None if v is None else v[usable] for v in (place, covariance, outlier, tops, scores)]
    own, spread, doubt, others, scored = parts
    assert own is not None
    assert spread is not None
    assert doubt is not None
    whole = doubt + np.trace(spread, axis1=1, axis2=2) / max(float(np.ptp(own, axis=0).max()) ** 2, 1e-12)
    try:
        neighbours = graph(profiles[usable], own, whole <= np.median(whole))
    except ValueError as error:
        raise SetupError(f"--refine: {error}") from None
    found = refine(neighbours, own, spread, doubt, others, scored)
    everything = Refined(place.copy(), 1 - outlier, np.zeros(len(place), np.bool_))
    everything.place[usable], everything.trust[usable] = found.place, found.trust
    everything.moved[usable] = found.moved
    return everything
