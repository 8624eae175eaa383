"""The estimators as a textbook writes them, one UE at a time in plain numpy: what the kernels are held to.

A spectrum is aᴴQa over the steering vectors a of a grid; the estimate is its largest or smallest value. It is
scanned in two ways: as one matrix product a UE, and literally, in a loop over the grid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]
Scan = Callable[[Complex, Complex], NDArray[Any]]

METHODS = ("bartlett", "mvdr", "minnorm", "music")
LOADING = 0.05


def form(method: str, x: Complex, order: int) -> Complex:
    """Q (N, N) of a method for snapshots x (N, M)."""
    n = len(x)
    r: Complex = x @ x.conj().T / x.shape[1]
    if method == "bartlett":
        return r
    if method == "mvdr":
        inverse: Complex = np.linalg.inv(r + LOADING * np.trace(r).real / n * np.eye(n))
        return inverse
    noise = np.linalg.eigh(r)[1][:, : n - order]
    if method == "music":
        projector: Complex = noise @ noise.conj().T
        return projector
    w = noise @ noise[0].conj()
    product: Complex = np.outer(w, w.conj())
    return product


def scan_at_once(q: Complex, a: Complex) -> NDArray[Any]:
    """aᴴQa over the columns of a (N, G), as a matrix product."""
    values: NDArray[Any] = np.sum(a.conj() * (q @ a), axis=0).real
    return values


def scan_one_by_one(q: Complex, a: Complex) -> NDArray[Any]:
    """The same, one column after the other."""
    return np.array([(v.conj() @ q @ v).real for v in a.T])


def locate(
    csi: Complex,
    methods: tuple[str, str],
    tables: tuple[Complex, Complex],
    order: int,
    scan: Scan = scan_at_once,
) -> NDArray[np.intp]:
    """Grid indices (K, 2) of theta and rho for frames csi (K, N_R, N_S), UE by UE.

    `tables` holds the steering vectors (N, G) of the angle grid and of the delay grid.
    """
    return np.array(
        [
            [
                _peak(method, scan(form(method, x, order), table))
                for method, x, table in zip(methods, (h, h.T), tables, strict=True)
            ]
            for h in csi
        ]
    )


def _peak(method: str, values: NDArray[Any]) -> int:
    return int(np.argmax(values) if method == "bartlett" else np.argmin(values))
