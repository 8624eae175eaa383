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
from collections import Counter
from pathlib import Path

from chachart.node.commands.benchmarks import captures, own_files
from chachart.node.commands.benchmarks.report import Table
from chachart.node.data.errors import SetupError

WORKER = "chachart.node.commands.benchmarks.damage_worker"
NAMES = (*captures.NAMES, *own_files.NAMES)
LONGEST_S = 1e6
REPORT_EVERY = 100
MOST_FAULTS = 20
"""Of a format; after so many it is given up."""
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
        counts, found = _read(name, arguments)
        total = sum(counts.values()) + len(found)
        seconds = time.monotonic() - started
        table.add(name, total, counts["read"], counts["refused"], len(found), total / seconds)
        faults += [f"{name}: {fault}" for fault in found]
    if faults:
        raise SetupError("\n".join(faults))
    return [table]


def _read(name: str, arguments: argparse.Namespace) -> tuple[Counter[str], list[str]]:
    """How many files of a format were read and refused, and which ended the reader.

    A worker that dies is followed by one that reports every file, so that the file is known.
    """
    counts: Counter[str] = Counter()
    faults: list[str] = []
    at, end = arguments.first, arguments.first + arguments.files
    while at < end and len(faults) < MOST_FAULTS:
        at, died = _batch(name, arguments, (at, end), REPORT_EVERY, counts)
        if died:
            at, died_again = _batch(name, arguments, (at, min(end, at + REPORT_EVERY)), 1, counts)
            faults.append(f"file {at} ended the reader (--first {at} --files 1): {died_again or died}")
            at += 1
    return counts, faults


def _batch(
    name: str, arguments: argparse.Namespace, files: tuple[int, int], report_every: int, counts: Counter[str]
) -> tuple[int, str]:
    """Have files from one number to another read: the first not reported, and why the worker died."""
    first, end = files
    task = {
        "format": name,
        "samples": [str(path) for path in arguments.sample],
        "files": end - first,
        "first": first,
        "seed": arguments.seed,
        "memory_mb": arguments.memory_mb,
        "seconds": arguments.seconds,
        "report_every": report_every,
    }
    limit_s = min(SLACK_S + arguments.seconds * task["files"], LONGEST_S)
    command = [sys.executable, "-m", WORKER, json.dumps(task)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as worker:
        try:
            out, err = worker.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            worker.kill()
            out, err = worker.communicate()
    at = first
    for line in out.splitlines()[-1:]:
        report = json.loads(line)
        at = report.pop("next")
        counts.update(report)
    if worker.returncode == 0:
        return at, ""
    reason = err.strip().splitlines()[-1:] or ["it said nothing"]
    return at, f"{reason[0]} ({worker.returncode})"
