"""Kernels in C, where they were built and the machine can run them; `Kernels.here` is None otherwise.

They do what numpy does beside them, to rounding, in a half to a third of the time: half of what is Hermitian,
nothing that is written to memory and read again. Each frame is worked out by itself.
"""

from __future__ import annotations

import ctypes
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]

MODULE: Final = f"{__name__}.kernels"
MOST_ELEMENTS: Final = 64
"""On the axis of covariances and lags: what is kept of a frame then stays in the nearest cache."""
_ITEM: Final = np.dtype(np.complex64).itemsize


class Kernels:
    """The functions of a library.

    Attributes
    ----------
    here
        Those to use; None to do the same in numpy.
    """

    here: ClassVar[Kernels | None] = None

    def __init__(self, library: ctypes.CDLL) -> None:
        whole, real, memory = ctypes.c_long, ctypes.c_double, ctypes.c_void_p
        self._lag_sums, self._covariances = library.chachart_lag_sums, library.chachart_covariances
        self._inverse_cholesky, self._extremum = library.chachart_inverse_cholesky, library.chachart_extremum
        self._lag_sums.argtypes = self._covariances.argtypes = [memory, *[whole] * 6, memory]
        self._inverse_cholesky.argtypes = [memory, whole, whole, memory]
        sizes, places = [whole] * 3, [memory] * 5
        self._extremum.argtypes = [memory, memory, *sizes, *places, whole, whole, real, memory, memory]
        for function in (self._lag_sums, self._covariances, self._inverse_cholesky, self._extremum):
            function.restype = None

    @staticmethod
    def take(x: NDArray[Any], elements: int) -> bool:
        """Are these numbers of the right kind, and not too many elements?"""
        return x.dtype == np.complex64 and elements <= MOST_ELEMENTS

    def lag_sums(self, x: Complex) -> NDArray[np.complex64]:
        """Lag polynomials (K, N) of X Xᴴ for factors x (K, N, M) of an even row: see `LagSums`."""
        return self._of_snapshots(self._lag_sums, x, x.shape[:2])

    def covariances(self, x: Complex) -> NDArray[np.complex64]:
        """X Xᴴ (K, N, N) of snapshot matrices x (K, N, M)."""
        return self._of_snapshots(self._covariances, x, (*x.shape[:2], x.shape[1]))

    def inverse_cholesky(self, r: Complex) -> NDArray[np.complex64]:
        """L^-1 where r = L Lᴴ (K, N, N); NaN for those of the batch that are not positive definite."""
        r = np.ascontiguousarray(r)
        out = np.empty(r.shape, np.complex64)
        self._inverse_cholesky(_at(r), len(r), r.shape[1], _at(out))
        return out

    def extremum(
        self,
        values: NDArray[np.float32],
        c: NDArray[np.complex64],
        grid: tuple[Floats, NDArray[np.intp], NDArray[np.intp], Floats, Floats],
        *,
        maximum: bool,
        steps: int,
        converged: float,
    ) -> tuple[Floats, Floats]:
        """As `Search.extremum` finds u and value (K,) from values (K, G) on a grid, of polynomials c (K, L).

        Parameters
        ----------
        grid
            Its points, the numbers of those before and after them, and how far down and up is searched from
            them, (G,) each.
        """
        values, c = np.ascontiguousarray(values), np.ascontiguousarray(c)
        u, value = np.empty((2, len(c)))
        places = map(_at, grid)
        sizes = len(c), values.shape[1], c.shape[1]
        self._extremum(
            _at(values), _at(c), *sizes, *places, maximum, steps, converged, _at(u), _at(value)
        )  # fmt: skip
        return u, value

    @staticmethod
    def _of_snapshots(function: Any, x: Complex, shape: tuple[int, ...]) -> NDArray[np.complex64]:
        if _ITEM not in x.strides[1:]:
            x = np.ascontiguousarray(x)
        out = np.empty(shape, np.complex64)
        function(_at(x), *x.shape, *(stride // _ITEM for stride in x.strides), _at(out))
        return out


@contextmanager
def in_numpy() -> Iterator[None]:
    """In here, the same is done in numpy."""
    kernels, Kernels.here = Kernels.here, None
    try:
        yield
    finally:
        Kernels.here = kernels


def _at(x: NDArray[Any]) -> int:
    """Where its numbers lie in memory."""
    address: int = x.__array_interface__["data"][0]
    return address


def _found() -> Kernels | None:
    spec = importlib.util.find_spec(MODULE)
    if spec is None or spec.origin is None:
        return None
    try:
        library = ctypes.CDLL(spec.origin)
    except OSError:  # of another machine
        return None
    return Kernels(library) if library.chachart_level() else None


Kernels.here = _found()
