"""Chart logs and recordings small enough for tests, made by the sink and the simulator themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from chart_samples import QUALITY, StillNode

from chachart.config.settings import ArraySettings
from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingWriter
from chachart.sinks.chart_log import ChartLog, ChartLogSettings
from chachart.sources.base import EndOfSource
from chachart.sources.simulator import Simulator, SimulatorSettings


def plotted_array() -> ArrayGeometry:
    return ArraySettings(antennas=8, subcarriers=8, subcarrier_spacing_hz=312500.0).geometry()


def near_truth(ues: int, *, seed: int = 0, position: bool = True) -> ChartUpdate:
    """A chart that is a few metres off at places before the array."""
    array = plotted_array()
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(100, 600, ues), rng.uniform(-500, 500, ues), np.full(ues, 1.5)])
    theta, rho = array.theta_rho(places)
    x, y = array.chart_of(places) + rng.normal(0, 5, (2, ues))
    return ChartUpdate(
        "lab",
        Method("music", "bartlett"),
        ue=np.arange(ues, dtype=np.uint64),
        time_ns=np.int64(1_700_000_000_000_000_000) + np.arange(ues) * 10**7,
        theta=theta,
        rho=rho,
        theta_std=np.full(ues, np.nan),
        rho_std=np.full(ues, 0.5),
        x=x,
        y=y,
        snr=rng.normal(10, 3, ues),
        snapshots=np.full(ues, 4.0),
        position=places.astype(np.float32) if position else None,
    )


def write_chart_log(path: Path, *updates: ChartUpdate, reports: int = 0, **settings: Any) -> Path:
    log = ChartLog(ChartLogSettings(path=path, every_s=0, **settings), plotted_array())
    log.open(StillNode())
    for update in updates:
        log.on_chart(update)
    for n in range(reports):
        log.on_quality(QUALITY | {"tw": 1 - 0.1 / (n + 1)})
    log.close()
    return path


def write_recording(path: Path, ues: int = 60, frames: int = 120) -> Path:
    settings = SimulatorSettings(ues=ues, frames=frames, frame_rate_hz=0.0, snr_db=20.0)
    array = plotted_array()
    with RecordingWriter(path, array) as writer, Simulator(settings, array) as source:
        try:
            while True:
                block = source.recv(1.0)
                if block is not None:
                    writer.write(block)
        except EndOfSource:
            pass
    return path
