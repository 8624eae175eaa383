"""`chachart bench scale --simulate`: what many UEs take, and what breaks first, from costs measured here."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import fields

from chachart.node.commands.benchmarks import costs as measuring
from chachart.node.commands.benchmarks.extrapolate import Costs, Demand, Needs, ceilings, needs
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.watched import Threads
from chachart.node.commands.shared.cli import progress
from chachart.node.runtime.capacity import memory_bytes

DEMANDS = ("ues=1e6", "ues=1e8")
MEASURED_UES = 8192
"""Their states do not fit into a core's cache, as those of many more do not."""
PARTS = {
    ("feeder", "reader"): "takes frames from the source, checks and cuts them",
    ("feeder", "main"): "dispatcher: hands blocks out, takes answers",
    ("feeder", "io"): "sends and receives",
    ("worker 0", "main"): "estimates",
    ("main", "node"): "collector: takes rows, keeps the chart",
    ("main", "sink publisher"): "publishes rows",
    ("main", "io"): "sends and receives",
    ("worker 0", "io"): "sends and receives",
}

Footprint = Callable[[int, int, int, tuple[str, str]], dict[str, float]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--simulate",
        nargs="*",
        metavar="NAME=NUMBER,...",
        help=f"compute what many UEs take, for each of these demands, from what this machine is measured to "
        f"need: {', '.join(field.name for field in fields(Demand))} (default: {' '.join(DEMANDS)})",
    )
    parser.add_argument(
        "--seconds", type=float, default=5.0, help="of each measurement for that (default: 5)"
    )


def run(arguments: argparse.Namespace, footprint: Footprint) -> list[Table]:
    """Measure, then compute.

    Raises
    ------
    SetupError
        If a demand is none, or the node that is measured does not run.
    """
    machine = Demand(cores=len(os.sched_getaffinity(0)), memory_gib=memory_bytes() / 2**30)
    demands = {text: Demand.parse(text, machine) for text in arguments.simulate or DEMANDS}
    method = (arguments.theta, arguments.rho)
    ues = min(arguments.max_ues, MEASURED_UES)
    with progress("measuring", measuring.STEPS) as done:
        costs, threads = measuring.measure(
            ues, arguments.seconds, method, lambda n: footprint(n, 32, 32, method), done
        )
    title = f"{' / '.join(method)}, {ues} UEs of 32 x 32"
    one = next(iter(demands.values()))
    return [_threads(title, threads), _costs(title, costs), _ceilings(costs, one), _needs(costs, demands)]


def _threads(title: str, threads: Threads) -> Table:
    table = Table(
        f"a node at full speed, one worker: {title}",
        ["process, thread", "us a frame", "% of the busiest", "what it does"],
    )
    slowest = max(threads.values())
    for (process, thread), spent in sorted(threads.items(), key=lambda item: -item[1]):
        if spent > 0.01 * slowest:
            what = PARTS.get((process, thread), "everything else")
            table.add(f"{process}, {thread}", spent, round(100 * spent / slowest), what)
    return table


def _costs(title: str, costs: Costs) -> Table:
    table = Table(f"what it costs: {title}", ["", "measured", "unit"])
    table.add("a frame in the whole node", costs.node, "us of processor time")
    table.add("of it in the worker", costs.worker, "us")
    table.add("a row in somebody who subscribes to all", costs.subscriber, "us")
    table.add("a position fused from four arrays", costs.fuser, "us")
    table.add("a UE in the worker's estimator", costs.state, "bytes")
    table.add("a UE in a table of newest rows", costs.row, "bytes")
    table.add("a frame on the wire", costs.csi, "bytes")
    table.add("a row on the wire", costs.chart, "bytes")
    table.add("one TCP connection, plain", costs.tcp_rate, "frames/s")
    table.add("one TCP connection, with keys", costs.curve_rate, "frames/s")
    table.add("snapshots to disk", costs.disk_rate / 1e6, "MB/s")
    return table


def _ceilings(costs: Costs, demand: Demand) -> Table:
    table = Table(
        f"one node on one machine: {_machine(demand)}, {demand.updates:g} updates a UE and second, "
        f"{demand.load:.0%} busy at most",
        ["ends at", "frames/s", "UEs", "what goes further"],
    )
    found = ceilings(costs, demand)
    for ceiling in found:
        table.add(ceiling.what, round(ceiling.frames), round(ceiling.frames / demand.updates), ceiling.help)
    table.notes = [f"breaks first: {found[0].what}; then {found[1].what}"]
    return table


def _needs(costs: Costs, demands: dict[str, Demand]) -> Table:
    table = Table("what it takes", ["", *demands])
    found = {text: needs(costs, demand) for text, demand in demands.items()}

    def row(name: str, value: Callable[[Demand, Needs], int | float | str]) -> None:
        table.add(name, *(value(demands[text], found[text]) for text in demands))

    row("frames/s", lambda d, n: round(d.frames))
    row("nodes (a feeder and a main process each)", lambda d, n: n.nodes)
    row("workers", lambda d, n: n.workers)
    row("processes that fuse", lambda d, n: n.fusers)
    row("processes that subscribe, for all rows", lambda d, n: n.subscribers)
    row("frames, Gbit/s", lambda d, n: n.csi_gbit)
    row("rows, Gbit/s to each who wants all", lambda d, n: n.chart_gbit)
    row("state and rows, GiB", lambda d, n: n.memory / 2**30)
    row("snapshots, MB/s in all", lambda d, n: n.snapshot / d.every_s / 1e6)
    for what in ("cores", "memory", "network"):
        row(f"machines, for {what}", lambda d, n, what=what: n.machines[what])  # type: ignore[misc]
    row("machines are bought for", lambda d, n: n.first)
    row("most of the cores go to", lambda d, n: n.dearest)
    table.notes = [
        f"{text}: machines of {_machine(demand)}, {demand.load:.0%} busy at most; {demand.updates:g} updates "
        f"a UE and second, {demand.arrays:g} arrays hear each"
        for text, demand in demands.items()
    ] + ["the network's speed is assumed (gbit=...), all else is measured"]
    return table


def _machine(demand: Demand) -> str:
    return f"{demand.cores:g} cores, {demand.memory_gib:.0f} GiB, {demand.gbit:g} Gbit/s"
