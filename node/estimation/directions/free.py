"""Elements anywhere: the spectrum follows from the covariance, by outer products of steering vectors.

With N elements the table has N^2 complex rows a_n* a_m. A Fourier series in azimuth and co-elevation would
need (2 extent + 6)^2 lags with as large a table for the same, and would be exact to 1e-5 only; this is
exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.directions.manifold import (
    LEAST_INFORMATION,
    PER_CELL,
    DirectionManifold,
    compass,
)
from chachart.node.estimation.directions.sphere import disc, fibonacci, unit

Complex = NDArray[np.complexfloating[Any, Any]]
Floats = NDArray[np.float64]


class FreeManifold(DirectionManifold):
    """Any positions, azimuth and elevation. Features are the matrices (K, N, N)."""

    def __init__(self, array: ArrayGeometry) -> None:
        super().__init__(array)
        self.points = self.grid(PER_CELL)[0]

    def grid(self, per_cell: float) -> tuple[Floats, Floats]:
        """See `DirectionManifold`: even in the projection on the plane, or on the sphere."""
        spacing = self.cell / per_cell
        points = fibonacci(spacing) if self.plane is None else disc(self.plane, spacing)
        if self.facing is not None:
            points = points[points @ self.facing > -1e-9]
        flat = points if self.plane is None else points - (points @ self.plane)[:, None] * self.plane
        return points, flat / spacing

    def features(self, x: Complex, conjugate: Complex) -> Complex:
        """X Xᴴ (K, N, N)."""
        product: Complex = np.matmul(x, conjugate.swapaxes(1, 2))
        return product

    def of_matrices(self, q: Complex) -> Complex:
        """q as it is."""
        return q

    def trace(self, features: Complex) -> NDArray[Any]:
        """tr Q (K,)."""
        total: NDArray[Any] = np.einsum("kii->k", features).real
        return total

    def table(self, points: Floats) -> Floats:
        """(2 N^2, G): real part and minus imaginary part of a_n* a_m."""
        a = self.steering(points).T
        products = (a.conj()[:, None] * a).reshape(self.size**2, -1)
        return np.stack([products.real, -products.imag], axis=1).reshape(2 * self.size**2, -1)

    def derivatives(self, features: Complex, d: Floats, e: Floats) -> tuple[Floats, Floats, Floats]:
        """See `DirectionManifold`; from Q a, Q a_1 and Q a_2."""
        a = self.steering_derivatives(d, e)
        images = np.matmul(features, a[:, :3].swapaxes(1, 2))
        g = np.matmul(a.conj(), images).real
        value = g[:, 0, 0]
        slope = 2 * g[:, 0, 1:3].T
        bend = 2 * np.stack([g[:, 3, 0] + g[:, 1, 1], g[:, 4, 0] + g[:, 1, 2], g[:, 5, 0] + g[:, 2, 2]])
        return value, slope, bend


class RingManifold(FreeManifold):
    """Any positions, azimuth alone: all directions are in the plane of right and normal.

    Elements on one line along right see their front alone, as uniform lines do.
    """

    def __init__(self, array: ArrayGeometry) -> None:
        super().__init__(array)
        self.facing = np.array([0.0, 0.0, 1.0]) if array.is_line else array.facing
        if self.facing is not None and abs(self.facing[1]) > 1 - 1e-6:
            self.facing = None
        self.plane = self._axes = None
        self.points = self.grid(PER_CELL)[0]

    def grid(self, per_cell: float) -> tuple[Floats, Floats]:
        """See `DirectionManifold`: even on the ring."""
        count = int(np.ceil(2 * np.pi * per_cell / self.cell))
        azimuth = np.linspace(-np.pi, np.pi, count, endpoint=False)
        points = unit(azimuth, np.zeros(len(azimuth)))
        if self.facing is not None:
            points = points[points @ self.facing > -1e-9]
        return points, points * (count / (2 * np.pi))

    def ways(self, d: Floats) -> Floats:
        """The way of growing azimuth, and none besides."""
        across = compass(d)[0]
        return np.stack([across, np.zeros_like(across)])

    def derivatives(self, features: Complex, d: Floats, e: Floats) -> tuple[Floats, Floats, Floats]:
        """See `DirectionManifold`; there is one way to go."""
        value, slope, bend = super().derivatives(features, d, e)
        slope[1] = bend[1] = 0
        bend[2] = bend[0]
        return value, slope, bend

    def coordinates(self, d: Floats) -> dict[str, Floats]:
        """theta and azimuth."""
        found = super().coordinates(d)
        del found["elevation"]
        return found

    def std(self, d: Floats, quality: Floats, information: Floats | None = None) -> dict[str, Floats]:
        """Of theta and azimuth, which are alike here."""
        if information is None:
            information = self.information(d, np.stack(compass(d)))
        arc = 1 / (quality * information[0] + LEAST_INFORMATION)
        return {"theta_std": np.sqrt(arc), "azimuth_std": np.sqrt(arc)}
