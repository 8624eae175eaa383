"""Fit what estimators say of their own errors to draws of the simulator's channels.

Writes the file that chachart ships beside its estimators: for each method a small network from evidence to
deviations and to the probability that the path is the direct one, and two by which rho = "auto" combines what
it sees. It takes about a minute for every 15 draws, of which ranges (--only ranges) are an eighth.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.training import draws, networks, ranges
from chachart.node.data.errors import SetupError
from chachart.node.estimation.judge import FILE, Judge, shipped, unjudged
from chachart.node.estimation.options import JOINT

Floats = NDArray[np.float64]

LEAST_NOISE = 3.0
"""A path is the direct one if it errs by less than half a resolution cell, or so many deviations of noise."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart train`."""
    parser.add_argument("--draws", type=int, default=240, metavar="N", help="worlds (%(default)s)")
    parser.add_argument("--ues", type=int, default=384, metavar="N", help="UEs of each (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="(%(default)s)")
    parser.add_argument(
        "--only", choices=("deviations", "ranges"), help="fit only these, the others as they are shipped"
    )
    parser.add_argument("--out", type=Path, default=Path(FILE), metavar="FILE.json", help="(%(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Draw, fit and write.

    Raises
    ------
    SetupError
        If numbers are out of range or the file cannot be written.
    """
    if arguments.draws < 8 or arguments.ues < draws.BLOCK_UES:
        raise SetupError(f"--draws must be at least 8, --ues at least {draws.BLOCK_UES}")
    trained = shipped() if arguments.only else {}
    if arguments.only != "ranges":
        samples = gather(arguments.draws, arguments.ues, arguments.seed)
        for name, sample in samples.items():
            trained[name] = fit(sample, arguments.seed).as_dict()
            print(f"{name}: fitted to {len(sample['evidence'])} estimates", file=sys.stderr)
    if arguments.only != "deviations":
        sample = ranges.gather(arguments.draws, arguments.ues, arguments.seed)
        trained |= {name: one.as_dict() for name, one in ranges.fit(sample, arguments.seed).items()}
        print(f"auto: fitted to {len(sample['evidence'])} estimates", file=sys.stderr)
    try:
        arguments.out.write_text(json.dumps(trained, indent=None) + "\n")
    except OSError as error:
        raise SetupError(f"{arguments.out} cannot be written: {error.strerror}") from None
    print(arguments.out)
    return 0


def gather(count: int, ues: int, seed: int) -> dict[str, dict[str, Floats]]:
    """Evidence, errors, deviations of noise alone and directness, by the name of the network."""
    pieces: dict[str, list[dict[str, Floats]]] = {}
    for n, draw in enumerate(draws.drawn(count, ues, seed)):
        csi, theta, rho = draws.world(draw)
        for method in draws.METHODS:
            with unjudged():
                at = draws.located(draw, csi, method)
            errors = {"theta": at["theta"] - theta, "rho": at["rho"] - rho}
            direct = {
                "theta": np.abs(np.cos(at["theta"]) - np.cos(theta)) < draw.cells[0] / 2,
                "rho": np.abs(errors["rho"]) < draw.cells[1] / 2,
            }
            for name, error in errors.items():
                direct[name] |= np.abs(error) < LEAST_NOISE * at[f"{name}_noise_std"]
            if method == JOINT:
                samples = {JOINT: _sample(at["joint_evidence"], at, errors, direct)}
            else:
                samples = {
                    f"{method}.{name}": _sample(at[f"{name}_evidence"], at, {name: error}, direct)
                    for name, error in errors.items()
                }
                both = np.concatenate([at["theta_evidence"], at["rho_evidence"]], axis=1)
                samples[method] = _sample(both, at, errors, direct)
            for name, sample in samples.items():
                pieces.setdefault(name, []).append(sample)
        print(f"\r{n + 1} of {count} draws", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {
        name: {key: np.concatenate([sample[key] for sample in samples]) for key in samples[0]}
        for name, samples in pieces.items()
    }


def fit(sample: dict[str, Floats], seed: int) -> Judge:
    """The network of one sample: a growth of variance for each coordinate, and log odds of directness."""
    weight = np.full(len(sample["evidence"]), 1 / len(sample["evidence"]))
    losses = [
        networks.likelihood(sample[f"{name}_error"], sample[f"{name}_std"], weight)
        for name in ("theta", "rho")
        if f"{name}_error" in sample
    ]
    losses.append(networks.logistic(sample["direct"] > 0, weight))
    return networks.fitted(sample["evidence"], networks.together(*losses), len(losses), seed)


def _sample(
    evidence: Floats, at: dict[str, NDArray[Any]], errors: dict[str, Floats], direct: dict[str, Any]
) -> dict[str, Floats]:
    sample = {"evidence": evidence, "direct": np.all([direct[n] for n in errors], axis=0).astype(float)}
    for name, error in errors.items():
        sample |= {f"{name}_error": error, f"{name}_std": at[f"{name}_noise_std"]}
    return sample
