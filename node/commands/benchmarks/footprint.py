"""Time and memory of one estimator with many UEs: a process of its own, so that its peak memory is its own.

Prints one JSON object: `us` a frame over the last pass, `state_bytes` by which the process grew, and
`peak_bytes`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time

import numpy as np

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.running import peak_bytes
from chachart.node.data.csi import CsiBlock
from chachart.node.estimation.estimator import ChartEstimator

BLOCK = 64


def main() -> None:
    """Feed `--ues` UEs `--passes` frames each and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("ues", "antennas", "subcarriers", "passes"):
        parser.add_argument(f"--{name}", type=int, required=True)
    parser.add_argument("--theta", required=True)
    parser.add_argument("--rho", required=True)
    arguments = parser.parse_args()
    array = ArraySettings(
        antennas=arguments.antennas, subcarriers=arguments.subcarriers, subcarrier_spacing_hz=312500.0
    ).geometry()
    frames = noisy_blocks(array, BLOCK, BLOCK)[0]
    estimator = ChartEstimator(array, theta=arguments.theta, rho=arguments.rho, max_ues=arguments.ues)
    before = peak_bytes(os.getpid())
    seconds = 0.0
    for _ in range(arguments.passes):
        seconds = 0.0
        for start in range(0, arguments.ues, BLOCK):
            ue = np.arange(start, min(start + BLOCK, arguments.ues), dtype=np.uint64)
            block = CsiBlock(array.name, start, ue, frames.time_ns[: len(ue)], frames.csi[: len(ue)])
            begin = time.perf_counter()
            estimator.update(block)
            seconds += time.perf_counter() - begin
    json.dump(
        {
            "us": seconds / arguments.ues * 1e6,
            "state_bytes": peak_bytes(os.getpid()) - before,
            "peak_bytes": peak_bytes(os.getpid()),
        },
        sys.stdout,
    )


if __name__ == "__main__":
    main()
