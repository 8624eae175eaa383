"""Arrays and blocks of CSI for tests: small, seeded, with every column filled."""

from __future__ import annotations

from typing import Any

import numpy as np

from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry

START_NS = 1_700_000_000_000_000_000


def small_array(antennas: int = 4, subcarriers: int = 3, **changes: Any) -> ArrayGeometry:
    values: dict[str, Any] = {
        "name": "lab",
        "antennas": antennas,
        "subcarriers": subcarriers,
        "carrier_hz": 2e9,
        "subcarrier_spacing_hz": 312_500.0,
        "element_spacing_m": 0.075,
    }
    return ArrayGeometry(**(values | changes))


def some_block(
    frames: int = 5,
    *,
    antennas: int = 4,
    subcarriers: int = 3,
    seq: int = 0,
    seed: int = 0,
    start_ns: int = START_NS,
    step_ns: int = 1_000_000,
    position: bool = True,
    array: str = "lab",
) -> CsiBlock:
    """Frames of random UEs, `step_ns` apart."""
    rng = np.random.default_rng([seed, seq])
    shape = (frames, antennas, subcarriers)
    csi = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    known = rng.normal(0, 100, (frames, 3)).astype(np.float32)
    return CsiBlock(
        array,
        seq,
        rng.integers(0, 1000, frames).astype(np.uint64),
        start_ns + step_ns * np.arange(frames, dtype=np.int64),
        csi,
        known if position else None,
    )


def assert_same_frames(actual: CsiBlock | list[CsiBlock], expected: CsiBlock | list[CsiBlock]) -> None:
    """The same frames bit for bit, however they are cut into blocks."""
    a = CsiBlock.concatenate(actual) if isinstance(actual, list) else actual
    b = CsiBlock.concatenate(expected) if isinstance(expected, list) else expected
    assert a.array == b.array
    np.testing.assert_array_equal(a.ue, b.ue)
    np.testing.assert_array_equal(a.time_ns, b.time_ns)
    assert a.csi.shape == b.csi.shape
    assert a.csi.tobytes() == b.csi.tobytes()
    assert (a.position is None) == (b.position is None)
    if a.position is not None and b.position is not None:
        np.testing.assert_array_equal(a.position, b.position)
