"""Attack: mutated inputs to every decoder, and floods on every socket of a running node.

What may come of an input is a value or a clean error; anything else is a fault, and the command fails. Of
each flood the table tells what it cost: estimates a second beside a quiet node's, what was dropped and turned
away, and how the memory of the node's processes grew.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from chachart.node.commands.benchmarks.attack_floods import FLOODS, Target
from chachart.node.commands.benchmarks.attack_inputs import DECODERS, Decoder
from chachart.node.commands.benchmarks.damage_worker import mutated
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import RunningNode, footprints
from chachart.node.commands.shared.cli import progress
from chachart.node.data.errors import SetupError

LONGEST_S = 2.0
"""No decoder may take longer for one input."""
MOST_GROWTH_BYTES = 512 * 1024**2
STEP = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench attack`."""
    parser.add_argument("--inputs", type=int, default=10_000, metavar="N", help="to each (%(default)s)")
    parser.add_argument("--decoder", choices=DECODERS, action="append", help="only this one; may be repeated")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each flood (%(default)s)")
    parser.add_argument("--flood", choices=FLOODS, action="append", help="only this one; may be repeated")
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
    return tables


def _inputs(arguments: argparse.Namespace) -> Table:
    table = Table("Mutated inputs", ["decoder", "inputs", "taken", "refused", "inputs/s", "slowest ms", "MB"])
    names = arguments.decoder or list(DECODERS)
    with progress("inputs", len(names) * arguments.inputs) as done:
        for name in names:
            taken, took, slowest, growth = _decode(name, DECODERS[name](), arguments, done)
            n = arguments.inputs
            table.add(name, n, taken, n - taken, n / took, slowest * 1e3, growth / 1e6)
    return table


def _decode(
    name: str, decoder: Decoder, arguments: argparse.Namespace, done: Callable[[int], None]
) -> tuple[int, float, float, int]:
    """How many inputs were taken, seconds in all and for the slowest, and growth of memory in bytes."""
    taken, slowest, spent = 0, 0.0, 0.0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for n in range(arguments.inputs):
        rng = np.random.default_rng([arguments.seed, n])
        data = mutated(decoder.samples[n % len(decoder.samples)], rng)
        begin = time.perf_counter()
        try:
            decoder.decode(data)
            taken += 1
        except decoder.refusals:
            pass
        except Exception as error:
            raise SetupError(f"{name}, input {n} of seed {arguments.seed}: {error!r}") from error
        took = time.perf_counter() - begin
        spent += took
        slowest = max(slowest, took)
        if (n + 1) % STEP == 0 or n + 1 == arguments.inputs:
            done(n % STEP + 1)
    growth = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if slowest > LONGEST_S or growth > MOST_GROWTH_BYTES:
        raise SetupError(f"{name}: one input took {slowest:.1f} s, all of them {growth / 1e6:.0f} MB")
    return taken, spent, slowest, growth


def _floods(arguments: argparse.Namespace) -> Table:
    columns = ["flood", "thrown", "estimates/s", "% of quiet", "dropped", "turned away", "MB more"]
    table = Table(f"Floods of {arguments.seconds:g} s on a node that charts 1000 frames/s", columns)
    with tempfile.TemporaryDirectory(prefix="chachart-attack-") as folder:
        target = Target()
        with RunningNode(Path(folder), target.config()) as node, target.fed(node):
            quiet = _measure(target, node, lambda until: 0, arguments.seconds)
            table.add("none", *quiet)
            for name in arguments.flood or FLOODS:
                table.add(name, *_measure(target, node, FLOODS[name](target), arguments.seconds, quiet[1]))
            node.stop()
    return table


def _measure(
    target: Target,
    node: RunningNode,
    flood: Callable[[float], int],
    seconds: float,
    quiet: float | None = None,
) -> tuple[int, float, float, int, int, float]:
    before, bytes_before, begin = target.status(), _bytes(node), time.monotonic()
    thrown = flood(begin + seconds)
    node.rest(max(0.01, begin + seconds - time.monotonic()))
    took, after = time.monotonic() - begin, target.status()
    rate = (after["frames_estimated"] - before["frames_estimated"]) / took
    dropped = sum(after["dropped"].values()) - sum(before["dropped"].values())
    refused = target.refused(after) - target.refused(before)
    share = 100.0 if quiet is None else 100 * rate / quiet
    return thrown, rate, share, dropped, refused, (_bytes(node) - bytes_before) / 1e6


def _bytes(node: RunningNode) -> int:
    return sum(footprint.bytes for footprint in footprints(node.pid).values())
