"""Watch a node's chart in the terminal: every UE a dot that moves.

    chachart watch                             the default node, on this machine
    chachart watch tcp://lab.example:5556 --ue 17

Dots are coloured by their angle to the array; q ends it. Where the output is no terminal, a line is printed
every second, or with --json one JSON object for each chart message.
"""

from __future__ import annotations

import argparse
import colorsys
import json
import sys
import time
from collections import deque

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.style import Style
from rich.text import Text

from chachart.node.commands.shared.canvas import characters, fit, scatter
from chachart.node.commands.shared.cli import add_key_options
from chachart.node.commands.shared.keyboard import typed
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS
from chachart.node.net.client import ENDPOINT, Subscription, subscribe

KEEP_S = 60.0
REFRESH_S = 0.1
LINE_S = 1.0
EXTREMES = 5
WINDOW_S = 2.0
"""Rates are over so long."""

_HUES = 24
_STYLES = [
    Style(
        color="#{:02x}{:02x}{:02x}".format(
            *(round(255 * c) for c in colorsys.hsv_to_rgb(0.8 * n / _HUES, 0.7, 1))
        )
    )
    for n in range(_HUES)
]
_FOLLOWED = Style(color="white", bold=True, reverse=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart watch`."""
    parser.add_argument(
        "endpoint", nargs="?", default=ENDPOINT, help="where the node publishes (%(default)s)"
    )
    parser.add_argument("--array", help="of which array; else of all that are published there")
    parser.add_argument("--ue", type=int, help="follow this UE: mark it and print its estimates")
    parser.add_argument(
        "--keep", type=float, default=KEEP_S, metavar="S", help="UEs unheard for so long go (%(default)g)"
    )
    add_key_options(parser)
    parser.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds")
    parser.add_argument("--json", action="store_true", help="print every chart message as a line of JSON")


def run(arguments: argparse.Namespace) -> int:
    """Watch until q, Ctrl-C or the end of `--duration`.

    Raises
    ------
    SetupError
        If the endpoint is none.
    """
    end = None if arguments.duration is None else time.monotonic() + arguments.duration
    keys = {"key": arguments.key, "server_key": arguments.server_key}
    with subscribe(arguments.endpoint, arguments.array, **keys) as charts:
        watch = Watch(charts, arguments.ue, arguments.keep)
        if arguments.json:
            _print_json(charts, end)
        elif sys.stdout.isatty():
            with Live(watch, auto_refresh=False, screen=True) as live, typed() as pressed:
                while not _over(end) and "q" not in pressed():
                    watch.receive(REFRESH_S)
                    live.refresh()
        else:
            while not _over(end):
                watch.receive(LINE_S)
                print(watch.line(), flush=True)
    return 0


class Watch:
    """The chart so far and how it comes in; rich draws it."""

    def __init__(self, charts: Subscription, followed: int | None = None, keep_s: float = KEEP_S) -> None:
        self.charts = charts
        self.followed = followed
        self.keep_ns = int(keep_s * 1e9)
        self.chart: ChartUpdate | None = None
        self.others: set[str] = set()
        self._arrivals: deque[tuple[float, NDArray[np.uint64]]] = deque()
        self._began = time.monotonic()

    def receive(self, seconds: float) -> None:
        """Take in what comes during so many seconds."""
        deadline = time.monotonic() + seconds
        updates = [] if self.chart is None else [self.chart]
        while (left := deadline - time.monotonic()) > 0:
            update = self.charts.recv(left)
            if update is None:
                continue
            if updates and update.array != updates[0].array:
                self.others.add(update.array)
                continue
            updates.append(update)
            self._arrivals.append((time.monotonic(), update.ue))
        if updates:
            self.chart = ChartUpdate.concatenate(updates)
            kept = self.chart.time_ns > self.chart.time_ns.max() - self.keep_ns
            self.chart = self.chart.take(kept)
        while self._arrivals and self._arrivals[0][0] < time.monotonic() - WINDOW_S:
            self._arrivals.popleft()

    def line(self) -> str:
        """How the chart comes in, as one line."""
        if self.chart is None:
            return f"waiting for a chart from {self.charts.endpoint}"
        chart = self.chart
        rate = sum(len(ues) for _, ues in self._arrivals) / self._window_s()
        words = [f"{chart.array}: {len(chart)} UEs", f"{rate:.0f} estimates/s" if rate else "silent"]
        words.append(f"{chart.method.theta}/{chart.method.rho}")
        quality = self.charts.quality or {}
        words += [f"{name.upper()} {quality[name]:.4f}" for name in ("tw", "ct") if quality.get(name)]
        dropped = sum((self.charts.status or {}).get("dropped", {}).values())
        words += [f"{dropped} frames dropped by the node"] * bool(dropped)
        words += [f"{self.charts.lost} messages lost here"] * bool(self.charts.lost)
        words += [f"--array shows {name}" for name in sorted(self.others)]
        if (row := self._followed_row()) is not None:
            words.append(f"UE {self.followed}: {_row(chart, row)}")
        return ", ".join(words)

    def node(self) -> str:
        """How the node is, by its last status report, as one line."""
        report = self.charts.status
        if report is None:
            return "no status report from the node yet"
        words = [f"node {report.get('state')}", f"{report.get('frames_in_per_s') or 0:.0f} frames/s in"]
        words.append(f"backlog {report.get('backlog_frames') or 0}")
        latency = report.get("latency_ms") or {}
        words += [f"latency {name} {latency[name]:.1f} ms" for name in ("p50", "p99") if latency.get(name)]
        workers = report.get("workers") or []
        running = sum(worker.get("pid") is not None for worker in workers)
        restarts = sum(worker.get("restarts", 0) for worker in workers)
        words += [f"{running} of {len(workers)} workers" + f", {restarts} restarts" * bool(restarts)]
        for what in ("dropped", "rejected"):
            reasons = (f"{count} {reason}" for reason, count in (report.get(what) or {}).items() if count)
            if listed := ", ".join(reasons):
                words.append(f"{what}: {listed}")
        return ", ".join(words)

    def extremes(self) -> str:
        """The UEs with most estimates a second, and those whose place is least sure, as one line."""
        if self.chart is None:
            return ""
        words = []
        if self._arrivals:
            ues, counts = np.unique(np.concatenate([ues for _, ues in self._arrivals]), return_counts=True)
            most = np.argsort(-counts, kind="stable")[:EXTREMES]
            shown = (f"{ues[n]} ({counts[n] / self._window_s():.1f}/s)" for n in most)
            words.append(f"busiest: {', '.join(shown)}")
        spread = np.hypot(self.chart.rho * self.chart.theta_std, self.chart.rho_std)
        if np.isfinite(spread).any():
            worst = np.argsort(-np.nan_to_num(spread), kind="stable")[:EXTREMES]
            shown = (f"{self.chart.ue[n]} (+-{spread[n]:.1f} m)" for n in worst)
        else:
            worst = np.argsort(np.nan_to_num(self.chart.snr, nan=np.inf), kind="stable")[:EXTREMES]
            shown = (f"{self.chart.ue[n]} ({self.chart.snr[n]:.1f} dB)" for n in worst)
        return "   ".join([*words, f"worst: {', '.join(shown)}"])

    def _window_s(self) -> float:
        return max(1e-3, min(WINDOW_S, time.monotonic() - self._began))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(self.line(), style="bold", no_wrap=True, overflow="ellipsis")
        yield Text(self.node(), style="dim", no_wrap=True, overflow="ellipsis")
        if self.chart is not None:
            yield Text(self.extremes(), style="dim", no_wrap=True, overflow="ellipsis")
            yield from self._plot(options.max_width, (options.height or console.height) - 5)

    def _plot(self, columns: int, rows: int) -> RenderResult:
        chart = self.chart
        if chart is None or columns < 2 or rows < 2:
            return
        bounds = fit(chart.x, chart.y, columns, rows)
        dots, owner = scatter(chart.x, chart.y, bounds, columns, rows)
        hue = np.clip(np.nan_to_num(chart.theta) / np.pi * _HUES, 0, _HUES - 1).astype(int)
        followed = self._followed_row()
        for text, points in zip(characters(dots), owner.tolist(), strict=True):
            line = Text(text, no_wrap=True)
            for column, point in enumerate(points):
                if point >= 0:
                    style = _FOLLOWED if point == followed else _STYLES[hue[point]]
                    line.stylize(style, column, column + 1)
            yield line
        left, right, bottom, top = bounds
        ranges = f"x {left:.0f} to {right:.0f} m, y {bottom:.0f} to {top:.0f} m, array at x = y = 0"
        yield Text(ranges, style="dim", no_wrap=True, overflow="ellipsis")

    def _followed_row(self) -> int | None:
        if self.chart is None or self.followed is None:
            return None
        rows = np.flatnonzero(self.chart.ue == self.followed)
        return int(rows[0]) if len(rows) else None


def _print_json(charts: Subscription, end: float | None) -> None:
    while not _over(end):
        update = charts.recv(LINE_S if end is None else max(0.0, min(LINE_S, end - time.monotonic())))
        if update is None:
            continue
        print(json_line(update, charts.gap), flush=True)


def _row(chart: ChartUpdate, row: int) -> str:
    """What there is about a UE, for people."""
    shown = (c for c in COLUMNS.values() if c.name in chart.columns and c.unit != "ns" and c.name != "ue")
    return ", ".join(f"{c.label} {c.text(chart[c.name][row])} {c.for_people()[0]}".rstrip() for c in shown)


def json_line(update: ChartUpdate, gap: int) -> str:
    """An update as `--json` prints it; `gap` messages were lost before it."""
    return json.dumps({"gap": gap, **update.plain()})


def _over(end: float | None) -> bool:
    return end is not None and time.monotonic() >= end
