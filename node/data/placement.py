"""Where an array really is and how late its clock: what is found from UEs at known places, and how surely."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from chachart.node.data.calibration import Calibration
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.pose import Vector


@dataclass(frozen=True, slots=True)
class Placement:
    """What calibration says of one of several arrays.

    Parameters
    ----------
    name
        Which array.
    offset_s
        How much later its clock says that everything arrives; of clocks that UEs do not share, than that of
        the first array. None: unknown.
    offset_std_s
        Its deviation.
    position_m, axis, broadside
        Pose, as in `ArrayGeometry`; None: as the array is described.
    position_std_m
        Deviations along world x, y and z of the array's middle.
    turn_std_rad
        Deviations of its orientation about its own right, up and normal; 0 where it is not known better than
        described.
    """

    name: str
    offset_s: float | None = None
    offset_std_s: float = 0.0
    position_m: Vector | None = None
    axis: Vector | None = None
    broadside: Vector | None = None
    position_std_m: Vector = (0.0, 0.0, 0.0)
    turn_std_rad: Vector = (0.0, 0.0, 0.0)

    def posed(self, array: ArrayGeometry) -> ArrayGeometry:
        """The array where it really is.

        Raises
        ------
        ValueError
            If the pose is none.
        """
        if self.position_m is None or self.axis is None or self.broadside is None:
            return array
        return replace(array, position_m=self.position_m, axis=self.axis, broadside=self.broadside)

    def as_dict(self) -> dict[str, Any]:
        """Plain values; `Placement(**values)` reads them back."""
        return asdict(self)

    def on_time(self, array: ArrayGeometry) -> ArrayGeometry:
        """The array with a calibration that undoes its clock's offset, too."""
        if not self.offset_s:
            return array
        order = tuple(range(array.antennas))
        before = array.calibration or Calibration.order_only(order, array.subcarriers)
        late = np.asarray(before.subcarrier_phase_rad) - 2 * np.pi * self.offset_s * array.offsets_hz
        phases = tuple(float(phase) for phase in np.angle(np.exp(1j * late)))
        return replace(array, calibration=replace(before, subcarrier_phase_rad=phases))


def placed_arrays(
    arrays: Iterable[ArrayGeometry], placements: Iterable[Placement]
) -> tuple[ArrayGeometry, ...]:
    """The arrays where they really are.

    Raises
    ------
    ValueError
        If a placement is of none of them, or its pose is none.
    """
    arrays, by_name = tuple(arrays), {one.name: one for one in placements}
    if unknown := set(by_name) - {array.name for array in arrays}:
        there = ", ".join(array.name for array in arrays)
        raise ValueError(f"there is no array {', '.join(sorted(unknown))}, only {there}")
    return tuple(by_name[a.name].posed(a) if a.name in by_name else a for a in arrays)
