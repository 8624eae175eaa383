"""Channels of known paths, for tests of the estimators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry

WIDE: dict[str, Any] = {"subcarrier_spacing_hz": 312.5e3}
JOINT: dict[str, Any] = {"theta": "joint", "rho": "joint"}


@dataclass
class Multipath:
    """Plane waves of theta (rad), rho (m) and amplitude (U, L); the first path is the direct one."""

    array: ArrayGeometry
    theta: np.ndarray
    rho: np.ndarray
    amplitude: np.ndarray
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        n = np.arange(self.array.antennas) - (self.array.antennas - 1) / 2
        s = np.arange(self.array.subcarriers)
        band = 1 + (self.array.subcarriers - 1) / 2 * self.array.subcarrier_spacing_hz / self.array.carrier_hz
        u = self.array.theta_phase * band * np.cos(self.theta)
        self.waves = (
            self.amplitude[..., None, None]
            * np.exp(1j * u[..., None] * n)[..., None]
            * np.exp(1j * self.array.rho_phase * self.rho[..., None] * s)[..., None, :]
        )
        self.turn = np.exp(2j * np.pi * self.rng.random(self.theta.shape))

    def block(self, snr_db: float, *, phase: str = "steady", frames: int = 1) -> CsiBlock:
        """`frames` of each UE; phases are "steady", or "random" by frame or, with UEs "moving", by path."""
        count = len(self.theta)
        csi = []
        for _ in range(frames):
            turn = self.turn
            if phase == "moving":
                turn = np.exp(2j * np.pi * self.rng.random(self.theta.shape))
            elif phase == "random":
                turn = turn * np.exp(2j * np.pi * self.rng.random((count, 1)))
            shape = (count, self.array.antennas, self.array.subcarriers, 2)
            noise = self.rng.standard_normal(shape) @ [1, 1j] * 10 ** (-snr_db / 20) / 2**0.5
            csi.append(np.einsum("ul,ulns->uns", turn, self.waves) + noise)
        ue = np.tile(np.arange(count, dtype=np.uint64), frames)
        return CsiBlock("lab", 0, ue, np.zeros(len(ue), np.int64), np.concatenate(csi).astype(np.complex64))

    def errors(self, update: ChartUpdate) -> tuple[np.ndarray, np.ndarray]:
        return np.abs(update.theta - self.theta[:, 0]), np.abs(update.rho - self.rho[:, 0])


def weaker_first(array: ArrayGeometry, count: int, paths: int = 3, seed: int = 0) -> Multipath:
    """Direct paths 4 dB below each of their echoes, which come from 70 m later on, up to 10 degrees off."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(np.pi / 4, 3 * np.pi / 4, (count, 1)) + rng.uniform(-0.17, 0.17, (count, paths))
    rho = rng.uniform(100, 600, (count, 1)) + np.sort(rng.uniform(70, 300, (count, paths)), axis=1)
    theta[:, 0] = theta[:, 1:].mean(axis=1)
    rho[:, 0] = rho[:, 1] - rng.uniform(70, 100, count)
    amplitude = np.ones((count, paths))
    amplitude[:, 0] = 10 ** (-4 / 20)
    return Multipath(array, theta, rho, amplitude, seed)


def one_path(array: ArrayGeometry, rho: np.ndarray, theta: np.ndarray | None = None) -> Multipath:
    if theta is None:
        theta = np.random.default_rng(1).uniform(0.6, 2.5, len(rho))
    return Multipath(array, theta[:, None], rho[:, None], np.ones((len(rho), 1)))
