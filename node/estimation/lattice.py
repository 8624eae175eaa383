"""Elements on a line at whole multiples of one step: an even row, one with gaps, or one that is not even.

Their steering vectors a_n(u) = exp(j p_n u) have whole p_n, which keeps aᴴQa a polynomial in the lags
p_m - p_n.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

LOBE_POINTS = 8
"""Points per resolution cell between which side lobes are looked for."""
SPARSE = 4
"""Beyond so many places an element, only the lags that occur are worked with."""


@dataclass(frozen=True)
class Lattice:
    """Places p_n of elements, ascending from 0, without a common divisor.

    Attributes
    ----------
    places
        p_n.
    """

    places: tuple[int, ...]

    @classmethod
    def even(cls, size: int) -> Lattice:
        """0, 1 ... size - 1."""
        return cls(tuple(range(size)))

    @classmethod
    def of(cls, numbers: NDArray[Any]) -> tuple[Lattice, int]:
        """The lattice of ascending whole numbers (N,), and its step: numbers = first + step * places."""
        steps = np.diff(numbers)
        step = max(int(np.gcd.reduce(steps)), 1) if len(steps) else 1
        return cls(tuple(((numbers - numbers[0]) // step).tolist())), step

    @classmethod
    def of_antennas(cls, array: ArrayGeometry) -> tuple[Lattice, int]:
        """Those of a line's elements that count."""
        return cls.of(np.flatnonzero(array.live_antennas))

    @classmethod
    def of_tones(cls, array: ArrayGeometry) -> tuple[Lattice, int]:
        """The tones that count."""
        return cls.of(array.tone_numbers[array.live_tones])

    @property
    def size(self) -> int:
        """N."""
        return len(self.places)

    @property
    def span(self) -> int:
        """Places from the first element to the last, both included."""
        return self.places[-1] + 1

    @property
    def dense(self) -> bool:
        """Whether there is an element at each place."""
        return self.span == self.size

    @property
    def sparse(self) -> bool:
        """Whether there are so few that work over all places would not pay."""
        return self.span > SPARSE * self.size

    @property
    def symmetric(self) -> bool:
        """Whether the row is its own mirror image."""
        return self.places == tuple(self.span - 1 - p for p in reversed(self.places))

    @cached_property
    def index(self) -> Whole:
        """`places` as an array."""
        return np.array(self.places, np.int64)

    @cached_property
    def lags(self) -> Whole:
        """The L lags of the polynomials, from 0: all below `span`, or those that occur if it is sparse."""
        if not self.sparse:
            return np.arange(self.span)
        return np.unique(np.abs(self.index[:, None] - self.index))

    @cached_property
    def derivative_weights(self) -> Floats:
        """(3, L) of c_k exp(j k u): real part 1 for the value, imaginary part -k, real part -k^2 for the
        derivatives."""
        k = self.lags.astype(np.float64)
        return np.stack([np.ones_like(k), -k, -k * k])

    @cached_property
    def pairs(self) -> Floats:
        """(L,) how many pairs of elements have each lag; an element counts as a pair with itself."""
        there = self.spread_out(np.ones(self.size), 0)
        count: Floats = np.rint(np.correlate(there, there, "full")[self.span - 1 :][self.lags])
        return count

    @cached_property
    def centred(self) -> Floats:
        """p_n less their mean."""
        places = self.index.astype(np.float64)
        return places - float(places.mean())

    @cached_property
    def moment(self) -> float:
        """Sum of the squares of `centred`, N (N^2 - 1) / 12 for an even row."""
        return float(self.centred @ self.centred)

    @cached_property
    def side_lobe(self) -> float:
        """Power of a path's highest side lobe, the path's own being 1; 0.05 for even rows."""
        points = np.abs(np.fft.rfft(self.spread_out(np.ones(self.size), 0), LOBE_POINTS * self.span))
        rises = np.flatnonzero(np.diff(points) > 0)
        return float((points[rises[0] :].max() / self.size) ** 2) if len(rises) else 0.0

    def spread_out(self, x: NDArray[Any], axis: int) -> NDArray[Any]:
        """`x` with zeros along `axis` where there is no element, from N to `span`."""
        if self.dense:
            return x
        shape = list(x.shape)
        shape[axis] = self.span
        out = np.zeros(shape, x.dtype)
        out[(slice(None),) * axis + (self.index,)] = x
        return out
