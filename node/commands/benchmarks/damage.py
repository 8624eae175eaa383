"""Damage: mutated captures of every format and files of the node's own, read in a bounded process each.

What may come of a file is frames or a clean error. Anything else, an exception of another kind, a crash, too
much memory or time, is a fault: the table names the file by its seed, and the command fails.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from chachart.node.commands.benchmarks import captures, own_files
from chachart.node.commands.benchmarks.report import Table
from chachart.node.data.errors import SetupError

WORKER = "chachart.node.commands.benchmarks.damage_worker"
NAMES = (*captures.NAMES, *own_files.NAMES)
LONGEST_S = 1e6
SLACK_S = 60.0
"""Beyond the time that its files may take, a worker that says nothing is dead."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench damage`."""
    parser.add_argument("--files", type=int, default=10_000, metavar="N", help="of each format (%(default)s)")
    parser.add_argument("--format", choices=NAMES, action="append", help="only this one; may be repeated")
    parser.add_argument(
        "--sample", type=Path, action="append", default=[], metavar="FILE", help="mutate this too"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the mutations (%(default)s)")
    parser.add_argument(
        "--first", type=int, default=0, metavar="N", help="number of the first file (%(default)s)"
    )
    parser.add_argument("--memory-mb", type=int, default=2048, help="address space of a reader (%(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="for one file (%(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Read mutated captures of each format.

    Raises
    ------
    SetupError
        If a file gave anything but frames or a clean error.
    """
    table = Table("Mutated captures", ["format", "files", "read", "refused", "faults", "files/s"])
    faults: list[str] = []
    for name in arguments.format or NAMES:
        started = time.monotonic()
        counts, fault = _read(name, arguments)
        total = sum(counts.values())
        table.add(
            name,
            total,
            counts["read"],
            counts["refused"],
            int(fault != ""),
            total / (time.monotonic() - started),
        )
        if fault:
            faults.append(f"{name}: {fault}")
    if faults:
        raise SetupError("\n".join(faults))
    return [table]


def _read(name: str, arguments: argparse.Namespace) -> tuple[dict[str, int], str]:
    """How many files of a format were read and refused, and the fault that ended it, if any did."""
    task = {
        "format": name,
        "samples": [str(path) for path in arguments.sample],
        "files": arguments.files,
        "first": arguments.first,
        "seed": arguments.seed,
        "memory_mb": arguments.memory_mb,
        "seconds": arguments.seconds,
    }
    limit_s = min(SLACK_S + arguments.seconds * arguments.files, LONGEST_S)
    command = [sys.executable, "-m", WORKER, json.dumps(task)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as worker:
        try:
            out, err = worker.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            worker.kill()
            out, err = worker.communicate()
    counts = {"read": 0, "refused": 0}
    at = arguments.first
    for line in out.splitlines():
        report = json.loads(line)
        counts, at = {key: report[key] for key in counts}, report["next"]
    if worker.returncode == 0:
        return counts, ""
    what = err.strip().splitlines()[-1:] or ["it said nothing"]
    return (
        counts,
        f"file {at} or soon after it (--first {at}) ended the reader ({worker.returncode}): {what[0]}",
    )
