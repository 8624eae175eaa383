"""Quality: trustworthiness and continuity, exact beside scikit-learn, and sampled for charts of many UEs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import time_in_turn
from chachart.node.commands.shared.cli import progress
from chachart.node.estimation.quality import Neighbourhoods, neighbourhoods

Points = NDArray[np.float64]

CHART_ERROR_M = 30.0
NEIGHBOURS = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench quality`."""
    parser.add_argument("--exact", type=int, nargs="*", default=[2048, 4096], help="default: 2048 4096")
    parser.add_argument("--sampled", type=int, nargs="*", default=[2048, 10_000, 100_000])
    parser.add_argument("--runs", type=int, default=5, help="timed runs (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Exact figures in turn with scikit-learn's, then sampled ones."""
    with progress("charts judged", len(arguments.exact) + len(arguments.sampled)) as done:
        exact = _exact(arguments, done)
        sampled = _sampled(arguments, done)
    return [exact, sampled]


def _exact(arguments: argparse.Namespace, done: Callable[[int], None]) -> Table:
    table = Table("exact TW and CT", ["UEs", "K", "s", "two scikit-learn calls, s", "x faster", "differs by"])
    for n in arguments.exact:
        truth, chart = charts(n)
        k = round(NEIGHBOURS * n)
        ours: Callable[[], Any] = partial(neighbourhoods, truth, chart, k)
        theirs = _scikit_learn(truth, chart, k)
        if theirs is None:
            table.add(n, k, time_in_turn({"ours": ours}, runs=arguments.runs)["ours"], None, None, None)
            table.notes = ["scikit-learn is not installed here"]
        else:
            seconds = time_in_turn({"ours": ours, "theirs": theirs}, runs=arguments.runs)
            faster = seconds["theirs"].median / seconds["ours"].median
            found, (tw, ct) = ours(), theirs()
            differs = max(abs(found.tw - tw), abs(found.ct - ct))
            table.add(n, k, seconds["ours"], seconds["theirs"], faster, differs)
        done(1)
    return table


def _sampled(arguments: argparse.Namespace, done: Callable[[int], None]) -> Table:
    table = Table("sampled TW and CT", ["UEs", "K", "anchors", "s", "TW", "TW error", "CT", "CT error"])
    for n in arguments.sampled:
        truth, chart = charts(n)
        k = round(NEIGHBOURS * n)
        sample = partial(_sample, truth, chart, k)
        seconds = time_in_turn({"sample": sample}, runs=arguments.runs)["sample"]
        found = sample()
        table.add(n, k, found.anchors, seconds, found.tw, found.tw_error, found.ct, found.ct_error)
        done(1)
    return table


def _sample(truth: Points, chart: Points, k: int) -> Neighbourhoods:
    return neighbourhoods(truth, chart, k, rng=np.random.default_rng(0))


def charts(n: int) -> tuple[Points, Points]:
    """A truth (n, 2) as wide as the reference scenario, and a chart of it with errors of `CHART_ERROR_M`."""
    rng = np.random.default_rng(n)
    truth = rng.uniform((100, -500), (600, 500), (n, 2))
    return truth, truth + rng.normal(0, CHART_ERROR_M / math.sqrt(2), truth.shape)


def _scikit_learn(truth: Points, chart: Points, k: int) -> Callable[[], tuple[float, float]] | None:
    try:
        from sklearn.manifold import trustworthiness
    except ImportError:
        return None
    return lambda: (
        float(trustworthiness(truth, chart, n_neighbors=k)),
        float(trustworthiness(chart, truth, n_neighbors=k)),
    )
