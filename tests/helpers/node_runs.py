"""What tests of whole nodes share: a capture, a node as a process, and waiting for things to happen."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator

DEADLINE_S = 60.0
ARRAY = ArrayGeometry("lab", 16, 8, 2e9, 312_500.0, 0.0749481145)


def until(condition: Callable[[], Any], what: str) -> None:
    """Wait for a condition, not for a time."""
    deadline, timer = time.monotonic() + DEADLINE_S, threading.Event()
    while not condition():
        assert time.monotonic() < deadline, f"never happened: {what}"
        timer.wait(0.02)


def capture_blocks(ues: int = 40, rounds: int = 25, block: int = 100) -> list[CsiBlock]:
    """Plane waves of UEs at random places, in turn, with noise."""
    rng = np.random.default_rng(5)
    position = np.column_stack([rng.uniform(100, 600, ues), rng.uniform(-400, 400, ues), np.zeros(ues)])
    theta, rho = ARRAY.theta_rho(position)
    n, s = np.arange(ARRAY.antennas)[:, None], np.arange(ARRAY.subcarriers)
    phase = ARRAY.theta_phase * np.cos(theta)[:, None, None] * n + ARRAY.rho_phase * rho[:, None, None] * s
    ue = np.tile(np.arange(ues), rounds)
    noise = rng.standard_normal((2, len(ue), ARRAY.antennas, ARRAY.subcarriers)) / 2
    csi = (np.exp(1j * phase)[ue] + noise[0] + 1j * noise[1]).astype(np.complex64)
    return [
        CsiBlock(
            "lab",
            start,
            ue[start : start + block].astype(np.uint64),
            1_700_000_000_000_000_000 + 1_000_000 * np.arange(start, min(start + block, len(ue))),
            csi[start : start + block],
            position[ue[start : start + block]].astype(np.float32),
        )
        for start in range(0, len(ue), block)
    ]


def children(parent: int, what: str) -> list[int]:
    """Process ids of the children of `parent` that run the runtime's module `what`."""
    tasks = Path(f"/proc/{parent}/task").iterdir()
    pids = [pid for task in tasks for pid in _read(task / "children").split()]
    return [int(pid) for pid in pids if f"runtime.{what}" in _read(Path(f"/proc/{pid}/cmdline"))]


def _read(path: Path) -> str:
    """What a file of /proc says; nothing if its thread or process has just gone."""
    try:
        return path.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


@dataclass
class Running:
    """A node as a process of its own."""

    process: subprocess.Popen[str]
    log: Path
    summary_file: Path

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def finish(self) -> int:
        return self.process.wait(DEADLINE_S)

    def said(self) -> str:
        return self.log.read_text()

    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = json.loads(self.summary_file.read_text())
        return summary

    def children(self, what: str) -> list[int]:
        """Process ids of the node's children that run the module `what`."""
        return children(self.process.pid, what)


def adds_up(summary: dict[str, Any]) -> bool:
    """Every frame that came in was estimated or dropped for a reason."""
    return bool(summary["frames_in"] == summary["frames_estimated"] + sum(summary["dropped"].values()))


def undisturbed(frames: int) -> ChartUpdate:
    """The chart that the library makes of as many frames."""
    estimator, loop = ChartEstimator(ARRAY, averaging="mean"), CsiBlock.concatenate(capture_blocks())
    loops, rest = divmod(frames, len(loop))
    for _ in range(loops - 1):
        estimator.update(loop)
    update = estimator.update(CsiBlock.concatenate([loop, loop.cut(0, rest)]) if rest else loop)
    return update.take(np.argsort(update.ue))


def assert_same_chart(chart: ChartUpdate | None, expected: ChartUpdate, *, logged: bool = False) -> None:
    """They have the same UEs, which have learnt the same; a log rounds to the decimals of its columns."""
    assert chart is not None
    chart = chart.take(np.argsort(chart.ue))
    np.testing.assert_array_equal(chart.ue, expected.ue)
    np.testing.assert_array_equal(chart.snapshots, expected.snapshots)
    for name in ("theta", "rho", "x", "y", "theta_std", "rho_std", "snr", "p_direct"):
        atol = 10.0 ** -COLUMNS[name].decimals if logged else 0.0
        np.testing.assert_allclose(
            chart.columns[name], expected.columns[name], rtol=1e-5, atol=atol, err_msg=name
        )
