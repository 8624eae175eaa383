"""A simulated front-end in a process of its own, and what the same frames look like without any link."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.sources.base import EndOfSource, Source
from chachart.sources.simulator import Simulator, SimulatorSettings

ARRAY = ArrayGeometry("lab", 4, 8, 2e9, 312_500.0, 299_792_458.0 / 4e9, (0.0, 0.0, 10.0), height_m=8.5)
"""A small array, as lab.toml has it but for its size."""
UES = 50
DEADLINE_S = 60.0


def scenario(frames: int) -> dict[str, Any]:
    """Simulator settings for so many frames as fast as the link takes them."""
    return {"ues": UES, "frame_rate_hz": 0.0, "frames": frames, "snr_db": 20.0}


@contextmanager
def front_end(*arguments: str, frames: int) -> Iterator[subprocess.Popen[str]]:
    """`chachart frontend` in a process of its own, playing `frames` frames of the scenario on `ARRAY`."""
    changes = {f"source.{key}": value for key, value in scenario(frames).items()}
    for name in ("antennas", "subcarriers", "element_spacing_m"):
        changes[f"array.{name}"] = getattr(ARRAY, name)
    settings = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
    command = [
        sys.executable,
        "-m",
        "chachart.node.commands.main",
        "frontend",
        "--json",
        *arguments,
        *settings,
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline().startswith("front-end on ")
        yield process
    finally:
        process.terminate()
        process.wait(DEADLINE_S)
        process.stdout.close()


def report(process: subprocess.Popen[str]) -> dict[str, int]:
    """What a front-end that has come to its end says of its frames."""
    out, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    counts: dict[str, int] = json.loads(out.splitlines()[-1])
    return counts


def listen(source: Source, accounted: int) -> list[CsiBlock]:
    """Blocks of an open source until every one of `accounted` frames has come or is known to be lost."""
    blocks: list[CsiBlock] = []
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        try:
            block = source.recv(0.05)
        except EndOfSource:
            return blocks
        if block is not None:
            blocks.append(block)
        counts = source.details()["front_ends"].values()
        if sum(c["frames"] + c["lost"] for c in counts) >= accounted:
            return blocks
    raise AssertionError(f"not all of {accounted} frames came: {source.details()}")


def direct(frames: int) -> CsiBlock:
    """The same frames straight from the scenario."""
    blocks = []
    with Simulator(SimulatorSettings.model_validate(scenario(frames)), ARRAY) as source:
        while sum(len(b) for b in blocks) < frames:
            block = source.recv(1.0)
            if block is not None:
                blocks.append(block)
    return CsiBlock.concatenate(blocks)


def assert_same_chart(got: CsiBlock, sent: CsiBlock) -> None:
    """Frames and the chart of them are the same but for quantisation to 16 bits."""
    assert origin(got, sent).tolist() == list(range(len(sent)))
    charts = []
    for block in (got, sent):
        estimator = ChartEstimator(ARRAY, theta="bartlett", rho="bartlett", averaging="mean")
        charts.append(estimator.update(block))
    assert charts[0].ue.tolist() == charts[1].ue.tolist()
    np.testing.assert_allclose(charts[0].theta, charts[1].theta, atol=1e-3)
    np.testing.assert_allclose(charts[0].rho, charts[1].rho, atol=0.1)


def origin(got: CsiBlock, sent: CsiBlock) -> NDArray[np.int64]:
    """Which frame of `sent` each of `got` is; each must be one, in order, but for quantisation."""
    step = np.abs(sent.csi.view(np.float32)).max() / 32767
    index = np.empty(len(got), np.int64)
    for ue in range(UES):
        here, there = np.flatnonzero(got.ue == ue), np.flatnonzero(sent.ue == ue)
        apart = np.abs(got.csi[here][:, None] - sent.csi[there]).max(axis=(2, 3))
        assert (apart.min(axis=1) < 2 * step).all()
        index[here] = there[apart.argmin(axis=1)]
    assert (np.diff(index) > 0).all()
    return index
