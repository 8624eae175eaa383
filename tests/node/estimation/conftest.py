"""A line-of-sight world of ten lines: spherical waves from UEs to a linear array, and noise."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator


class Los:
    """UEs at `position` (U, 3) seen by `array`; mean |h|^2 over everything is 1 before noise."""

    def __init__(self, array: ArrayGeometry, position: np.ndarray, seed: int = 0) -> None:
        self.array, self.position = array, position
        self.rng = np.random.default_rng(seed)
        distance = np.linalg.norm(position[:, None] - array.element_positions(), axis=-1)[:, :, None]
        frequency = array.carrier_hz + array.subcarrier_spacing_hz * np.arange(array.subcarriers)
        h = np.exp(-2j * np.pi * frequency * distance / array.light_speed_m_s) / distance
        self.h = (h / np.sqrt(np.mean(np.abs(h) ** 2))).astype(np.complex64)
        self.snr = np.mean(np.abs(self.h) ** 2, axis=(1, 2))
        """Linear, at 0 dB."""

    def block(self, snr_db: float, which: np.ndarray, *, phase: bool = True, time_ns: int = 0) -> CsiBlock:
        shape = (len(which), *self.h.shape[1:])
        noise = self.rng.standard_normal((*shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        turn = np.exp(2j * np.pi * self.rng.random((len(which), 1, 1))) if phase else np.ones(1)
        csi = self.h[which] * turn.astype(np.complex64) + noise * np.float32(10 ** (-snr_db / 20) / 2**0.5)
        return CsiBlock(
            self.array.name,
            0,
            which.astype(np.uint64),
            np.full(len(which), time_ns, np.int64),
            csi,
            self.position[which].astype(np.float32),
        )

    def chart(
        self, estimator: ChartEstimator, snr_db: float, frames: int = 10, *, phase: bool = True
    ) -> ChartUpdate:
        """The chart of all UEs after `frames` frames of each."""
        for t in range(frames):
            updates = [
                estimator.update(self.block(snr_db, which, phase=phase, time_ns=t))
                for which in np.array_split(np.arange(len(self.h)), max(len(self.h) // 64, 1))
            ]
        return ChartUpdate.concatenate(updates)


def make_array(**changes: object) -> ArrayGeometry:
    """The reference scenario's array, its middle at the origin and 10 m high."""
    values: dict[str, object] = {
        "name": "lab",
        "antennas": 32,
        "subcarriers": 32,
        "carrier_hz": 2e9,
        "subcarrier_spacing_hz": 9765.625,
        "element_spacing_m": 0.075,
        "position_m": (0.0, -15.5 * 0.075, 10.0),
        "light_speed_m_s": 3e8,
    }
    return ArrayGeometry.from_dict(values | changes)


def scattered(n: int, seed: int = 0) -> np.ndarray:
    """Positions (n, 3) all over the reference scenario's area."""
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(100, 600, n), rng.uniform(-500, 500, n), np.full(n, 1.5)], axis=1)


def far_away(n: int, seed: int = 0) -> np.ndarray:
    """Positions (n, 3) 600 m away, 30 to 150 degrees from the axis: plane waves of equal strength."""
    theta = np.random.default_rng(seed).uniform(np.pi / 6, 5 * np.pi / 6, n)
    return np.stack([600 * np.sin(theta), 600 * np.cos(theta), np.full(n, 10.0)], axis=1)


@pytest.fixture(autouse=True, scope="session")
def one_blas_thread() -> Iterator[None]:
    """Many small matrices: threads would only wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def array() -> ArrayGeometry:
    return make_array()


@pytest.fixture
def los() -> Callable[..., Los]:
    """`los(n, seed)`: n UEs of the reference scenario; `los(n, seed, far=True)`: equally strong ones."""

    def build(n: int, seed: int = 0, *, far: bool = False, **changes: object) -> Los:
        return Los(make_array(**changes), (far_away if far else scattered)(n, seed), seed)

    return build


def centre_truth(los: Los) -> tuple[np.ndarray, np.ndarray]:
    """True theta and rho from the array's middle, where a plane wave's phase refers to."""
    middle = los.array.element_positions().mean(axis=0)
    offset = los.position - middle
    rho = np.linalg.norm(offset, axis=1)
    return np.arccos(offset @ np.asarray(los.array.axis) / rho), rho


@pytest.fixture
def truth() -> Callable[[Los], tuple[np.ndarray, np.ndarray]]:
    return centre_truth
