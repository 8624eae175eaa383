"""Chart updates: where some UEs are, as far as the node can tell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.columns import COLUMNS
from chachart.node.data.extras import require
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import FUSION

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Method:
    """Names of the estimators behind a chart."""

    theta: str
    rho: str


class ChartUpdate:
    """Estimates for K UEs of one array, one row a UE, in the columns of `chachart.node.data.columns`.

    `update["rho"]` is a column by its name; an optional one that the update lacks is filled in. What nearly
    every chart has is also an attribute.

    Attributes
    ----------
    array, method
        Which array, and which estimators.
    columns
        What there is, by name: arrays (K,), or (K, parts). Not to be changed.
    ue, time_ns
        uint64 (K,) and int64 (K,): who, and the time of the last frame behind the estimate.
    theta, rho
        float64 (K,): cone angle to the array axis (rad, 0..pi) and slant range (m).
    theta_std, rho_std
        float64 (K,): standard deviations of theta (rad) and rho (m); NaN where the method gives none.
    x, y
        float64 (K,): chart coordinates in metres, see `chachart.node.data.geometry`.
    snr
        float64 (K,): signal to noise ratio in dB.
    snapshots
        float64 (K,): effective number of frames behind the estimate.
    position
        float32 (K, 3): known reference positions, world metres, NaN where unknown; None if none is known.

    Raises
    ------
    ValueError
        If a column is unknown or missing, or has another shape than it should.
    """

    __slots__ = ("array", "columns", "method")

    array: str
    method: Method
    columns: Mapping[str, NDArray[Any]]
    ue: NDArray[np.uint64]
    time_ns: NDArray[np.int64]
    theta: Floats
    rho: Floats
    theta_std: Floats
    rho_std: Floats
    x: Floats
    y: Floats
    snr: Floats
    snapshots: Floats

    def __init__(
        self,
        array: str,
        method: Method,
        ue: NDArray[np.uint64],
        time_ns: NDArray[np.int64],
        **columns: NDArray[Any] | None,
    ) -> None:
        self.array = array
        self.method = method
        given: dict[str, NDArray[Any]] = {"ue": ue, "time_ns": time_ns}
        given |= {name: values for name, values in columns.items() if values is not None}
        self.columns = given
        if missing := [c.name for c in COLUMNS.values() if not c.optional and c.name not in given]:
            raise ValueError(f"a chart update needs {', '.join(missing)}")
        for name, values in given.items():
            if name not in COLUMNS:
                raise ValueError(f"there is no column {name!r}, only {', '.join(COLUMNS)}")
            expected = COLUMNS[name].shape(len(ue))
            if values.shape != expected:
                raise ValueError(f"{name} must have shape {expected}, not {values.shape}")

    @property
    def position(self) -> NDArray[np.float32] | None:
        """Known reference positions (K, 3), or None."""
        return self.columns.get("position")

    def truth_of(self, array: ArrayGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Known positions in the coordinates of x and y: the world's, or those of a line's own chart.

        NaN where unknown.
        """
        known = np.asarray(self["position"], np.float64)
        if self.method.theta == FUSION:
            return known[:, 0], known[:, 1]
        return array.chart_of(known)

    def __len__(self) -> int:
        return len(self.columns["ue"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        values = self.columns.get(name)
        return COLUMNS[name].missing(len(self)) if values is None else values

    if not TYPE_CHECKING:  # mypy knows the attributes by their names above, and finds any other

        def __getattr__(self, name: str) -> NDArray[Any]:
            if name not in COLUMNS:
                raise AttributeError(f"a chart update has no {name!r}")
            return self[name]

    def __repr__(self) -> str:
        method = f"{self.method.theta}/{self.method.rho}"
        besides = "".join(f", {name}" for name in self.columns if COLUMNS[name].optional)
        return f"<ChartUpdate of {self.array!r} by {method}: {len(self)} UEs{besides}>"

    def take(self, index: NDArray[Any] | slice) -> ChartUpdate:
        """The rows that `index` (integers, a mask or a slice) picks, in that order."""
        columns = {name: values[index] for name, values in self.columns.items()}
        return ChartUpdate(self.array, self.method, **columns)

    def with_columns(self, **columns: NDArray[Any]) -> ChartUpdate:
        """The same rows with these columns, besides what they have or instead of it."""
        return ChartUpdate(self.array, self.method, **{**self.columns, **columns})

    def parts(self, rows: int) -> Iterator[ChartUpdate]:
        """The same in pieces of at most `rows` rows, none where there is no row."""
        if 0 < len(self) <= rows:
            yield self
            return
        for start in range(0, len(self), rows):
            yield self.take(slice(start, start + rows))

    def flat(self) -> dict[str, NDArray[Any]]:
        """What there is as columns of one number a row, in the schema's order: `position_x` and so on."""
        present = (column for column in COLUMNS.values() if column.name in self.columns)
        return {name: v for column in present for name, v in column.flat(self.columns[column.name])}

    def to_pandas(self) -> pd.DataFrame:
        """The rows as a data frame with the columns of `flat`; its `attrs` hold array and method.

        Raises
        ------
        SetupError
            If pandas is not installed.
        """
        require("pandas", "a data frame:")
        import pandas as pd

        frame = pd.DataFrame(self.flat())
        frame.attrs.update(array=self.array, theta=self.method.theta, rho=self.method.rho)
        return frame

    def plain(self) -> dict[str, Any]:
        """As plain values for JSON: columns as lists, rounded to their decimals, None where not finite."""
        method = {"theta": self.method.theta, "rho": self.method.rho}
        columns = {name: COLUMNS[name].plain(values) for name, values in self.columns.items()}
        return {"array": self.array, "method": method, **columns}

    @staticmethod
    def from_plain(values: Mapping[str, Any]) -> ChartUpdate:
        """The update behind plain values, as `plain` and chart messages have them; None becomes NaN.

        Columns that nobody here knows are left out.

        Raises
        ------
        KeyError, TypeError, ValueError, OverflowError
            If they are none.
        """
        method = Method(str(values["method"]["theta"]), str(values["method"]["rho"]))
        rows = len(values["ue"])
        columns = {
            column.name: np.array(values[column.name], column.dtype).reshape(column.shape(rows))
            for column in COLUMNS.values()
            if not column.optional or column.name in values
        }
        return ChartUpdate(str(values["array"]), method, **columns)

    @staticmethod
    def concatenate(updates: list[ChartUpdate]) -> ChartUpdate:
        """All rows in order; a UE that occurs twice keeps its last row. Array and method are the last's."""
        last = updates[-1]
        if len(updates) == 1:
            return last
        names = {name: None for update in updates for name in update.columns}
        columns = {name: np.concatenate([update[name] for update in updates]) for name in names}
        everything = ChartUpdate(last.array, last.method, **columns)
        _, from_end = np.unique(everything.ue[::-1], return_index=True)
        return everything.take(np.sort(len(everything) - 1 - from_end))
