"""The estimators as a textbook writes them, one UE at a time in plain numpy: what the kernels are held to.

Each takes a sample matrix x (N elements, M snapshots) and the steering vectors a (N, G) of a grid, and
returns the index of the grid point that the spectrum peaks at.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]


def bartlett(x: Complex, a: Complex) -> int:
    """Largest aᴴ R a."""
    r = x @ x.conj().T / x.shape[1]
    return int(np.argmax(np.sum(a.conj() * (r @ a), axis=0).real))


def mvdr(x: Complex, a: Complex, loading: float = 0.05) -> int:
    """Largest 1 / aᴴ R^-1 a, diagonally loaded."""
    n = len(x)
    r = x @ x.conj().T / x.shape[1]
    inverse = np.linalg.inv(r + loading * np.trace(r).real / n * np.eye(n))
    return int(np.argmax(1 / np.sum(a.conj() * (inverse @ a), axis=0).real))


def music(x: Complex, a: Complex, order: int = 1) -> int:
    """Largest 1 / |E_nᴴ a|^2, E_n the noise eigenvectors."""
    r = x @ x.conj().T / x.shape[1]
    noise = np.linalg.eigh(r)[1][:, : len(x) - order]
    return int(np.argmax(1 / np.sum(np.abs(noise.conj().T @ a) ** 2, axis=0)))


def minnorm(x: Complex, a: Complex, order: int = 1) -> int:
    """Largest 1 / |wᴴ a|^2, w the noise subspace's vector of least norm."""
    r = x @ x.conj().T / x.shape[1]
    noise = np.linalg.eigh(r)[1][:, : len(x) - order]
    w = noise @ noise[0].conj()
    return int(np.argmax(1 / np.abs(w.conj() @ a) ** 2))


METHODS: dict[str, Callable[..., int]] = {
    "bartlett": bartlett,
    "mvdr": mvdr,
    "minnorm": minnorm,
    "music": music,
}


def pair(
    csi: Complex, theta: str, rho: str, angle_table: Complex, delay_table: Complex, **options: Any
) -> NDArray[np.intp]:
    """Grid indices (K, 2) of theta and rho of frames csi (K, N_R, N_S), UE by UE."""
    options_of = {name: options if name in ("music", "minnorm") else {} for name in METHODS}
    return np.array(
        [
            (
                METHODS[theta](h, angle_table, **options_of[theta]),
                METHODS[rho](h.T, delay_table, **options_of[rho]),
            )
            for h in csi
        ]
    )
