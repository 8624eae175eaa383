"""Reproduce the published tables: every pair of estimators on three channels, in one HTML report.

    chachart reproduce
    chachart reproduce --channels los,qnlos --bandwidth 10e6 --out report
    chachart reproduce --channels qnlos --bandwidth 10e6 --data qnlos=measured.mcap

Writes report.html, results.json, the figures as PNG and PDF files, and the tables as CSV and LaTeX.
Trustworthiness, continuity and seconds stand
beside the published ones; the report has the charts, their curves over the number of neighbours, what range
by amplitude costs, errors beside the Cramér-Rao bound, and PCA and Sammon's mapping for comparison. Recorded
channels (--data) hold one frame without noise of each UE, as `chachart import` writes them; noise is added
here.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chachart.config.load import settings_of
from chachart.node.commands.benchmarks import machine
from chachart.node.commands.reproduction import accuracy, embeddings, paper, ranging, runs, scenario
from chachart.node.commands.reproduction.paper import Pair
from chachart.node.commands.reproduction.progress import steps
from chachart.node.commands.reproduction.results import WRITTEN, ChannelResults, Results
from chachart.node.commands.shared.scenes import data, pairs
from chachart.node.commands.shared.tables import as_csv, as_latex
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.estimation.curves import Ranks, neighbour_ranks

PAIRS: tuple[Pair, ...] = (*paper.PAIRS, ("joint", "joint"))
EMBEDDINGS = 2
FEWEST_UES = 64
MOST_UES = 8192
"""All ranks of all UEs are kept: 0.5 GB for so many."""
NEIGHBOURS_SHARE = 0.05
WIDE_HZ = 10e6
"""The errors of rho are shown at the chosen bandwidth and at this one."""

Progress = Callable[[str], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart reproduce`."""
    parser.add_argument("--channels", type=_channels, default=_channels("los,qlos,qnlos"), metavar="NAME,...")
    parser.add_argument(
        "--bandwidth",
        type=_positive,
        default=paper.BANDWIDTH_HZ,
        metavar="HZ",
        help="of all subcarriers together (%(default)g; 10e6 is the other one of interest)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("chachart-reproduce"), metavar="DIR", help="(%(default)s)"
    )
    parser.add_argument("--pairs", type=pairs, default=PAIRS, metavar="THETA/RHO,...", help="all by default")
    parser.add_argument(
        "--data", action="extend", nargs="+", type=data, default=[], metavar="CHANNEL=FILE.mcap",
        help="recorded channels instead of the model's",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="extend", nargs="+", default=[], metavar="estimator.KEY=VALUE",
        help="change a setting of every estimator, as for chachart-node",
    )  # fmt: skip
    counts = (
        ("--ues", FEWEST_UES, paper.UES, "UEs of the model's channels, at most of recorded ones"),
        ("--frames", 1, 10, "noisy frames of each UE"),
        ("--runs", 1, 3, "timed runs of each pair"),
        ("--paths", 0, 1000, "single paths at each SNR; 0 leaves out the errors"),
        ("--seed", 0, 0, "of positions, channels and noise"),
    )
    for name, least, default, words in counts:
        parser.add_argument(
            name, type=_whole(least), default=default, metavar="N", help=f"{words} ({default})"
        )
    parser.add_argument("--snr-db", type=float, default=paper.SNR_DB, metavar="DB", help="(%(default)g)")


def run(arguments: argparse.Namespace) -> int:
    """Run everything and write the report.

    Raises
    ------
    SetupError
        If an option does not fit or a file cannot be read or written.
    """
    require("bench", "chachart reproduce:")
    require("plot", "chachart reproduce:")
    from threadpoolctl import threadpool_limits

    start = time.perf_counter()
    options = _options(arguments.set)
    if not np.isfinite(arguments.snr_db) or abs(arguments.snr_db) > 200:
        raise SetupError(f"--snr-db {arguments.snr_db:g}: must be within -200 and 200")
    if arguments.ues > MOST_UES:
        raise SetupError(f"--ues {arguments.ues}: at most {MOST_UES}, for all pairs of UEs are ranked")
    recorded = dict(arguments.data)
    if unused := sorted(set(recorded) - set(arguments.channels)):
        raise SetupError(f"--data {unused[0]}=...: this channel is not among --channels")
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError(f"--out {arguments.out} cannot be made: {error.strerror}") from None
    arrays = [scenario.scenario_array(hz) for hz in dict.fromkeys((arguments.bandwidth, WIDE_HZ))]
    a_channel = 1 + len(arguments.pairs) * (arguments.runs + 1) + EMBEDDINGS
    a_channel += len(ranging.WAYS) * len(ranging.AMPLITUDES)
    total = a_channel * len(arguments.channels)
    total += len(arrays) * len(accuracy.SNRS_DB) if arguments.paths else 0
    try:
        with threadpool_limits(1), steps(total + 1) as progress:
            channels = [
                _channel(name, recorded.get(name), arguments, options, progress)
                for name in arguments.channels
            ]
            measured = _accuracy(arrays, arguments, options, progress) if arguments.paths else []
            results = Results(
                command=shlex.join(["chachart", *sys.argv[1:]]),
                settings=_settings(arguments, recorded),
                machine=machine.describe(),
                seconds=time.perf_counter() - start,
                channels=channels,
                accuracy=measured,
            )
            written = _write(arguments.out, results)
            progress("report")
    except OSError as error:
        raise SetupError(f"{error.filename or arguments.out} cannot be written: {error.strerror}") from None
    _print(channels)
    print(f"{written}  ({results.seconds:.0f} s)")
    return 0


def _channel(
    name: scenario.ChannelName,
    recording: Path | None,
    arguments: argparse.Namespace,
    options: dict[str, Any],
    progress: Progress,
) -> ChannelResults:
    draw = (arguments.ues, arguments.frames, arguments.snr_db, arguments.seed)
    if recording is None:
        scene = scenario.modelled(name, scenario.scenario_array(arguments.bandwidth), *draw)
    else:
        scene = scenario.recorded(name, recording, *draw)
    if len(scene.position) < FEWEST_UES:
        raise SetupError(f"{recording} has {len(scene.position)} UEs: at least {FEWEST_UES} are needed")
    label = WRITTEN[name]
    progress(f"{label}: {len(scene.position)} channels")
    truth = scene.truth
    ranks = neighbour_ranks(truth)
    k = max(round(NEIGHBOURS_SHARE * len(truth)), 1)
    spent: dict[Pair, list[runs.Spent]] = {pair: [] for pair in arguments.pairs}
    charts = {}
    for turn in range(arguments.runs):
        for pair in arguments.pairs:
            charts[pair], seconds = _estimate(scene, pair, options)
            spent[pair].append(seconds)
            progress(f"{label}, run {turn + 1}: {runs.display(pair)} {seconds.processor:.3f} s")
    charted = []
    for pair in arguments.pairs:
        judged = runs.judge_pair(scene, pair, charts[pair], ranks, k)
        judged.seconds = [one.processor for one in spent[pair]]
        judged.clock_seconds = [one.clock for one in spent[pair]]
        charted.append(judged)
        progress(f"{label}: {judged.name} TW {judged.tw[-1]:.4f} CT {judged.ct[-1]:.4f}")
    embedded = []
    for judged in _embedded(scene, ranks, k):
        embedded.append(judged)
        progress(f"{label}: {judged.name} TW {judged.tw[-1]:.4f} CT {judged.ct[-1]:.4f}")
    ranged = list(ranging.compare(scene, k, lambda words: progress(f"{label}: {words}")))
    return ChannelResults(name, scene.origin, truth, arguments.pairs, charted, embedded, ranged)


def _estimate(scene: scenario.Scene, pair: Pair, options: dict[str, Any]) -> tuple[ChartUpdate, runs.Spent]:
    try:
        return runs.estimate(scene, pair, options)
    except ValueError as error:
        raise SetupError(f"{runs.display(pair)} on {WRITTEN[scene.channel]}: {error}") from None


def _embedded(scene: scenario.Scene, ranks: Ranks, k: int) -> Iterator[runs.Charted]:
    """PCA, and Sammon's mapping, which starts from it."""
    watch = runs.Stopwatch()
    features = embeddings.features(scene.csi)
    components = embeddings.principal_components(features)
    found = [("PCA", components, watch.spent())]
    found.append(("Sammon", embeddings.sammon(features, components), watch.spent()))
    for name, xy, spent in found:
        judged = runs.judge(name, xy, scene.truth, ranks, k)
        judged.seconds, judged.clock_seconds = [spent.processor], [spent.clock]
        yield judged


def _accuracy(
    arrays: Sequence[Any], arguments: argparse.Namespace, options: dict[str, Any], progress: Progress
) -> list[accuracy.Accuracy]:
    used = {method for pair in arguments.pairs for method in pair}
    methods = tuple(method for method in accuracy.METHODS if method in used)
    found: list[accuracy.Accuracy] = []
    for n, array in enumerate(arrays):
        theta, rho = accuracy.measure(
            array, methods, arguments.paths, arguments.frames, arguments.seed, options, progress
        )
        found += [theta, rho] if n == 0 else [rho]
    return found


def _write(out: Path, results: Results) -> Path:
    from chachart.node.commands.reproduction import figures, report

    drawings: dict[str, figures.Drawing] = {}
    of_all = results.channels[0].pairs
    drawings["summary"] = figures.summary(of_all, {c.name: c.charted for c in results.channels})
    for c in results.channels:
        drawings[f"charts-{c.name}"] = figures.charts(c.truth, c.charted, c.embeddings)
        drawings[f"curves-{c.name}"] = figures.curves(c.pairs, c.charted, c.embeddings)
    if results.accuracy:
        drawings["accuracy"] = figures.accuracy(results.accuracy)
    pictures = {
        name: {theme.name: figures.png(drawing, theme) for theme in figures.THEMES}
        for name, drawing in drawings.items()
    }
    for name, themes in pictures.items():
        (out / f"{name}.png").write_bytes(themes["light"])
        (out / f"{name}.pdf").write_bytes(figures.pdf(drawings[name]))
    for c in results.channels:
        (out / f"table-{c.name}.csv").write_text(as_csv(c.table()))
        (out / f"table-{c.name}.tex").write_text(as_latex(c.table()))
    (out / "results.json").write_text(json.dumps(results.as_dict(), indent=1, allow_nan=False) + "\n")
    path = out / "report.html"
    path.write_text(report.render(results, pictures), "utf-8")
    return path


def _print(channels: Sequence[ChannelResults]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 120)
    for channel in channels:
        table = Table(
            title=f"{WRITTEN[channel.name]}, {channel.origin}, K = {channel.k}", title_justify="left"
        )
        table.add_column("theta / rho")
        for column in ("TW paper", "TW", "CT paper", "CT", "s paper", "s"):
            table.add_column(column, justify="right")
        rows = [
            (c, paper.published(channel.name, p)) for p, c in zip(channel.pairs, channel.charted, strict=True)
        ]
        for c, before in [*rows, *((c, None) for c in channel.embeddings)]:
            there = ["-" if v is None else f"{v:.4f}" for v in before or (None,) * 3]
            here = (f"{c.tw[-1]:.4f}", f"{c.ct[-1]:.4f}", f"{c.mean_seconds:.3f}")
            table.add_row(c.name, *(v for both in zip(there, here, strict=True) for v in both))
        console.print(table)


def _settings(arguments: argparse.Namespace, recorded: dict[str, Path]) -> dict[str, Any]:
    return {
        "channels": ", ".join(arguments.channels),
        "bandwidth_hz": arguments.bandwidth,
        "data": ", ".join(f"{name}: {path.name}" for name, path in recorded.items()) or "none, all modelled",
        "ues": arguments.ues,
        "frames": arguments.frames,
        "snr_db": arguments.snr_db,
        "seed": arguments.seed,
        "runs": arguments.runs,
        "paths": arguments.paths,
        "set": " ".join(arguments.set) or "nothing: averaging = mean, otherwise the estimators' defaults",
    }


def _options(overrides: Sequence[str]) -> dict[str, Any]:
    """The estimator settings that were given."""
    for text in overrides:
        key = text.partition("=")[0].strip()
        if not key.startswith("estimator.") or key in ("estimator.theta", "estimator.rho"):
            raise SetupError(f"--set {text}: only settings of [estimator], theta and rho by --pairs")
    settings = settings_of({"array": {}, "source": {"type": "simulator"}}, overrides, "options")
    return settings.estimator.model_dump(exclude_unset=True)


def _channels(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(text.lower().split(",")))
    if unknown := [name for name in names if name not in WRITTEN]:
        raise argparse.ArgumentTypeError(f'there is no channel "{unknown[0]}", only {", ".join(WRITTEN)}')
    return names


def _positive(text: str) -> float:
    value = float(text)
    if not (np.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} must be a number > 0")
    return value


def _whole(least: int) -> Callable[[str], int]:
    def whole(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"{text} must be at least {least}")
        return value

    return whole
