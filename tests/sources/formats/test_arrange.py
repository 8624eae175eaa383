from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from chachart.sources.formats.arrange import (
    column,
    defects,
    frames,
    identities,
    occurrence,
    positions,
    times_ns,
)

CSI = np.random.default_rng(1).standard_normal((4, 3, 2, 2)).view(np.complex128)[..., 0]
NAMES = ("ue", "antenna", "subcarrier")


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_axes_in_any_order(order: tuple[int, ...]) -> None:
    arranged = frames(CSI.transpose(order), [NAMES[n] for n in order])
    assert arranged.dtype == np.complex64
    np.testing.assert_array_equal(arranged, CSI.astype(np.complex64))


def test_a_missing_axis_means_one() -> None:
    assert frames(CSI[:, :, 0], ["ue", "antenna"]).shape == (4, 3, 1)
    assert frames(CSI[0], ["antenna", "subcarrier"]).shape == (1, 3, 2)
    assert frames(CSI[:, 0], ["subcarrier", "ue"]).shape == (2, 1, 4)


def test_a_last_axis_that_matlab_dropped() -> None:
    assert frames(CSI[:, :, 0], NAMES).shape == (4, 3, 1)


def test_real_and_imaginary_part_on_an_axis() -> None:
    pairs = np.stack([CSI.real, CSI.imag], axis=1)
    arranged = frames(pairs, ["ue", "iq", "antenna", "subcarrier"])
    np.testing.assert_array_equal(arranged, CSI.astype(np.complex64))


@pytest.mark.parametrize(
    ("csi", "axes", "message"),
    [
        (CSI, ["ue", "antena", "subcarrier"], 'there is no "antena"'),
        (CSI, ["ue", "ue", "subcarrier"], "named once"),
        (CSI, ["ue", "antenna"], "3 axes of lengths"),
        (CSI.real, NAMES, "complex values are needed, not float64"),
        (CSI.real, ["ue", "iq", "antenna"], "axis iq must hold 2 real numbers"),
        (CSI[:0], NAMES, "there is nothing in it"),
    ],
)
def test_axes_that_do_not_fit(csi: np.ndarray, axes: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        frames(csi, axes)


def test_defects_by_frame() -> None:
    csi = np.repeat(CSI.astype(np.complex64), 2, axis=0)
    csi[1] = 0
    csi[3] = 2 - 1j
    csi[5, 2, 1] = np.nan
    csi[6, 0, 0] = np.inf
    expected = ["", "is all zero", "", "is constant", "", "is not finite", "is not finite", ""]
    assert defects(csi).tolist() == expected


def test_numbers_too_large_for_complex64_are_found() -> None:
    csi = CSI.copy()
    csi[2, 0, 0] = 1e200
    assert defects(frames(csi, NAMES)).tolist() == ["", "", "is not finite", ""]


def test_positions() -> None:
    xyz = np.arange(12.0).reshape(4, 3)
    np.testing.assert_array_equal(positions(xyz, 4, 9.0), xyz)
    np.testing.assert_array_equal(positions(xyz.T, 4, 9.0), xyz)
    np.testing.assert_array_equal(positions(xyz[:, :2], 4, 9.0)[:, 2], 9.0)
    assert np.isnan(positions(np.full((4, 3), np.nan), 4, 9.0)).all()
    for wrong in (xyz[:3], xyz.astype(complex), np.full((4, 3), np.inf)):
        with pytest.raises(ValueError, match="must be"):
            positions(wrong, 4, 9.0)


def test_columns() -> None:
    assert column(np.array([[1, 2, 3]]), 3).tolist() == [1, 2, 3]
    assert column(np.array([[1], [2]]), 2).tolist() == [1, 2]
    with pytest.raises(ValueError, match="one value for each of 4 frames"):
        column(np.array([[1, 2], [3, 4]]), 4)


def test_identities() -> None:
    assert identities(np.array([3.0, 5.0])).tolist() == [3, 5]
    for wrong in (np.array([1.5]), np.array([-1]), np.array([np.nan]), np.array(["a"])):
        with pytest.raises(ValueError, match="whole numbers"):
            identities(wrong)


def test_times() -> None:
    assert times_ns(np.array([5], np.uint64)).tolist() == [5]
    assert times_ns(np.array([1.5, 1_700_000_000.25])).tolist() == [1_500_000_000, 1_700_000_000_250_000_000]
    for wrong in (np.array([np.nan]), np.array([1e10]), np.array(["a"])):
        with pytest.raises(ValueError, match="nanoseconds"):
            times_ns(wrong)


def test_occurrence_counts_each_ue_by_itself() -> None:
    rng = np.random.default_rng(2)
    ue = rng.integers(0, 5, 200).astype(np.uint64)
    seen: dict[int, int] = {}
    for who, n in zip(ue.tolist(), occurrence(ue).tolist(), strict=True):
        assert n == seen.get(who, 0)
        seen[who] = n + 1
