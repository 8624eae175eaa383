"""From direction and range to a place: in free space, or in the horizontal plane that the UEs are in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def placed(centre_m: Floats, direction: Floats, rho: Floats, height_m: float | None) -> Floats:
    """World positions (..., 3) in world directions (..., 3), unit vectors, at slant ranges rho (...).

    With `height_m`, the height of `centre_m` above the plane of the UEs, they are in that plane: the range is
    projected to it (a range too short lands below the centre), and where there is none (NaN) the direction
    alone says where it meets the plane; NaN if it does not, because it looks above the horizon.
    """
    if height_m is None:
        return centre_m + rho[..., None] * direction
    flat = np.linalg.norm(direction[..., :2], axis=-1)
    fall = -direction[..., 2]
    met = np.divide(height_m * flat, fall, out=np.full(flat.shape, np.nan), where=fall > 0)
    reach = np.where(np.isnan(rho), met, np.sqrt(np.maximum(rho * rho - height_m**2, 0.0)))
    along = direction[..., :2] / np.maximum(flat, 1e-300)[..., None]
    found = np.empty(direction.shape)
    found[..., :2] = centre_m[:2] + reach[..., None] * along
    found[..., 2] = centre_m[2] - height_m
    return found
