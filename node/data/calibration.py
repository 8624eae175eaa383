"""What an array does to the channels it measures, and how to undo it. Pure arrays; no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Calibration:
    """Order and response of the antennas, and response of the subcarriers.

    What a front-end measures at its input m on subcarrier k is `antenna[n] * subcarrier[k]` times the true
    channel of element n, where m = `antenna_order[n]`, later by `antenna_delay_s[n]`. Each response is a gain
    (amplitude) and a phase; a delay common to all antennas is a linear phase across the subcarriers.

    Parameters
    ----------
    antenna_order
        For each element of the array, the input it is connected to.
    antenna_gain, antenna_phase_rad
        Response of each element's way to the receiver.
    subcarrier_gain, subcarrier_phase_rad
        Response common to all antennas, per subcarrier.
    antenna_delay_s
        How much later each element's way is than the common one; empty: none is.

    Raises
    ------
    ValueError
        If `antenna_order` is no permutation, the lengths differ, or a gain is not positive.
    """

    antenna_order: tuple[int, ...]
    antenna_gain: tuple[float, ...]
    antenna_phase_rad: tuple[float, ...]
    subcarrier_gain: tuple[float, ...]
    subcarrier_phase_rad: tuple[float, ...]
    antenna_delay_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        antennas, subcarriers = len(self.antenna_order), len(self.subcarrier_gain)
        if sorted(self.antenna_order) != list(range(antennas)):
            raise ValueError(f"antenna_order must hold each of 0 to {antennas - 1} once")
        for name, expected in (
            ("antenna_gain", antennas),
            ("antenna_phase_rad", antennas),
            ("subcarrier_gain", subcarriers),
            ("subcarrier_phase_rad", subcarriers),
            ("antenna_delay_s", antennas if self.antenna_delay_s else 0),
        ):
            values = np.asarray(getattr(self, name), np.float64)
            if len(values) != expected:
                raise ValueError(f"{name} must have {expected} values, not {len(values)}")
            if not np.isfinite(values).all() or (name.endswith("gain") and not (values > 0).all()):
                raise ValueError(
                    f"{name} must be {'positive' if name.endswith('gain') else 'finite'} numbers"
                )

    @classmethod
    def of(
        cls,
        antenna_order: NDArray[Any] | tuple[int, ...],
        antenna: NDArray[np.complex128],
        subcarrier: NDArray[np.complex128],
        delay_s: NDArray[np.float64] | None = None,
    ) -> Self:
        """From complex responses: `antenna` (N_R,) by element, `subcarrier` (N_S,); and delays (N_R,)."""
        return cls(
            tuple(int(m) for m in antenna_order),
            tuple(np.abs(antenna).tolist()),
            tuple(np.angle(antenna).tolist()),
            tuple(np.abs(subcarrier).tolist()),
            tuple(np.angle(subcarrier).tolist()),
            () if delay_s is None else tuple(delay_s.tolist()),
        )

    @classmethod
    def order_only(cls, antenna_order: tuple[int, ...], subcarriers: int) -> Self:
        """Antennas that are only connected in another order."""
        return cls.of(
            antenna_order, np.ones(len(antenna_order), np.complex128), np.ones(subcarriers, complex)
        )

    @property
    def antennas(self) -> int:
        """N_R."""
        return len(self.antenna_order)

    @property
    def subcarriers(self) -> int:
        """N_S."""
        return len(self.subcarrier_gain)

    def corrector(self, offset_hz: NDArray[np.float64] | None = None) -> Corrector:
        """What undoes it; where antennas have delays, for subcarriers at `offset_hz` (N_S,) from the carrier.

        Raises
        ------
        ValueError
            If there are delays and no offsets.
        """
        antenna = np.asarray(self.antenna_gain) * np.exp(1j * np.asarray(self.antenna_phase_rad))
        subcarrier = np.asarray(self.subcarrier_gain) * np.exp(1j * np.asarray(self.subcarrier_phase_rad))
        order = np.asarray(self.antenna_order, np.intp)
        response = antenna[:, None] * subcarrier
        if self.antenna_delay_s:
            if offset_hz is None:
                raise ValueError("delays of antennas need the subcarriers' offsets from the carrier")
            response = response * np.exp(-2j * np.pi * np.outer(self.antenna_delay_s, offset_hz))
        weights = (1 / response).astype(np.complex64)
        return Corrector(None if (order == np.arange(len(order))).all() else order, weights)

    def apply(self, csi: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """The true channels behind measured ones, (..., N_R, N_S)."""
        return self.corrector()(csi)

    def as_dict(self) -> dict[str, Any]:
        """Plain values; `from_dict` reads them back."""
        kept = {name: list(values) for name, values in asdict(self).items()}
        if not self.antenna_delay_s:
            del kept["antenna_delay_s"]  # as in files from before they were known
        return kept

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build from `as_dict`'s values.

        Raises
        ------
        ValueError
            If a key is unknown or missing, or a value does not fit.
        """
        if not isinstance(values, Mapping):
            raise ValueError(f"a calibration is a table, not {type(values).__name__}")
        try:
            return cls(**{name: tuple(column) for name, column in values.items()})
        except (TypeError, OverflowError) as error:
            raise ValueError(f"not a calibration: {error}") from None


@dataclass(frozen=True, slots=True, eq=False)
class Corrector:
    """A calibration made ready for use: call it with CSI (..., N_R, N_S).

    `order` is None where every antenna is in its place; `weights` is complex64 (N_R, N_S).
    """

    order: NDArray[np.intp] | None
    weights: NDArray[np.complex64]

    def __call__(self, csi: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """The true channels behind measured ones."""
        if self.order is not None:
            csi = csi[..., self.order, :]
        corrected: NDArray[np.complex64] = csi * self.weights
        return corrected
