"""Attack: mutated inputs to every decoder, and floods on every socket and line of a running node.

What may come of an input is a value or a clean error; anything else is a fault, and the command fails. Of
each flood, which comes from a process of its own, the table tells what it cost: the frames of an honest
producer that get into the chart, beside a quiet node's, what was dropped and turned away, and how the memory
of the node's processes grew.
"""

from __future__ import annotations

import argparse
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path

from chachart.node.commands.benchmarks.attack_floods import FLOODS, MUTATED, flood
from chachart.node.commands.benchmarks.attack_inputs import DECODERS
from chachart.node.commands.benchmarks.attack_lines import LINES, line_config, listening, settled, throw_on
from chachart.node.commands.benchmarks.attack_target import (
    Target,
    Watched,
    apart,
    free_ports,
    held_bytes,
)
from chachart.node.commands.benchmarks.attack_worker import Thrown, bound, throw
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import RunningNode
from chachart.node.commands.shared.cli import progress
from chachart.node.data.errors import SetupError

CHUNK = 10_000
LINE_INPUTS = 20_000
MANY, LONGEST_FLOOD_S = 1 << 40, 3600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench attack`."""
    parser.add_argument("--inputs", type=int, default=10_000, metavar="N", help="to each (%(default)s)")
    parser.add_argument("--decoder", choices=DECODERS, action="append", help="only this one; may be repeated")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each flood (%(default)s)")
    parser.add_argument("--flood", choices=FLOODS, action="append", help="only this one; may be repeated")
    parser.add_argument("--line", choices=LINES, action="append", help="only this one; may be repeated")
    parser.add_argument(
        "--thrown", type=int, metavar="N", help="floods of mutated inputs go on until so many were thrown"
    )
    parser.add_argument("--no-floods", action="store_true", help="decoders alone")
    parser.add_argument("--seed", type=int, default=0, help="of the mutations (%(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Throw everything.

    Raises
    ------
    SetupError
        If an input gave anything but a value or a clean error, or the node did not live through a flood.
    """
    tables = [_inputs(arguments)] if arguments.inputs else []
    if not arguments.no_floods:
        tables.append(_floods(arguments))
        tables.append(_lines(arguments))
    return tables


def _inputs(arguments: argparse.Namespace) -> Table:
    table = Table("Mutated inputs", ["decoder", "inputs", "taken", "refused", "inputs/s", "MB more"])
    names, n = arguments.decoder or list(DECODERS), arguments.inputs
    with progress("inputs", len(names) * n) as done:
        for name in names:
            thrown = list(_thrown(name, arguments, done))
            taken, seconds = sum(t.taken for t in thrown), sum(t.seconds for t in thrown)
            table.add(name, n, taken, n - taken, n / seconds, sum(t.grown for t in thrown) / 1e6)
    return table


def _thrown(name: str, arguments: argparse.Namespace, done: Callable[[int], None]) -> Iterator[Thrown]:
    DECODERS[name]()  # an extra that is not installed is told before a process is started
    with apart(bound) as process:
        for first in range(0, arguments.inputs, CHUNK):
            count = min(CHUNK, arguments.inputs - first)
            try:
                yield process.submit(throw, name, arguments.seed, first, count).result()
            except BrokenProcessPool:
                where = f"inputs {first} to {first + count} of seed {arguments.seed}"
                raise SetupError(f"{name}, {where} ended the process") from None
            done(count)


def _floods(arguments: argparse.Namespace) -> Table:
    columns = ["flood", "thrown", "estimates/s", "% of quiet", "longest pause s"]
    columns += ["dropped", "turned away", "MB more at most", "MB more after"]
    table = Table("Floods on a node that charts 1000 frames/s", columns)
    target, seconds = Target(), arguments.seconds
    with (
        tempfile.TemporaryDirectory(prefix="chachart-attack-") as folder,
        RunningNode(Path(folder), target.config()) as node,
        target.fed(node),
        apart() as process,
    ):
        quiet = target.watch(node, None, seconds)
        _add(table, "none", 0, quiet, quiet.rate)
        for name in arguments.flood or FLOODS:
            limits = (
                (LONGEST_FLOOD_S, arguments.thrown)
                if arguments.thrown and name in MUTATED
                else (seconds, MANY)
            )
            thrown = process.submit(flood, name, target.ports, *limits)
            watched = target.watch(node, thrown, 0.0 if limits[1] < MANY else seconds)
            _add(table, name, thrown.result(), watched, quiet.rate)
        node.stop()
    return table


def _lines(arguments: argparse.Namespace) -> Table:
    columns = [
        "line",
        "thrown",
        "inputs/s",
        "rejected",
        "good among them",
        "of these charted",
        "MB more at most",
    ]
    table = Table("Mutated inputs on lines that a node listens to", columns)
    count = arguments.thrown or LINE_INPUTS
    for name in arguments.line or LINES:
        port, web = free_ports(2)
        with tempfile.TemporaryDirectory(prefix="chachart-attack-") as folder, apart() as process:
            early = None if LINES[name].node_comes_first else _throw_on(process, name, port, count, arguments)
            with RunningNode(Path(folder), line_config(name, port, web)) as node:
                listening(node, web)
                begin, held = time.monotonic(), held_bytes(node)
                thrown = early or _throw_on(process, name, port, count, arguments)
                highest = held
                while not thrown.done():
                    node.rest(0.2)
                    highest = max(highest, held_bytes(node))
                took, good = time.monotonic() - begin, thrown.result()
                charted, rejected = settled(node, web)
                table.add(name, count, count / took, rejected, good, charted, (highest - held) / 1e6)
                node.stop()
    return table


def _throw_on(
    process: Executor, name: str, port: int, count: int, arguments: argparse.Namespace
) -> Future[int]:
    """Begin; who has to be there before the node is."""
    thrown = process.submit(throw_on, name, port, count, arguments.seed)
    while not LINES[name].node_comes_first and not thrown.done():
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            break
    return thrown


def _add(table: Table, name: str, thrown: int, watched: Watched, quiet: float) -> None:
    share = 100 * watched.rate / quiet
    memory = (watched.highest / 1e6, watched.grown / 1e6)
    table.add(name, thrown, watched.rate, share, watched.pause_s, watched.dropped, watched.refused, *memory)
