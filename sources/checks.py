"""Which frames are worth estimating from."""

from __future__ import annotations

import numpy as np

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry


def misfit(came: tuple[int, int], array: ArrayGeometry) -> str:
    """In words, that frames of (antennas, subcarriers) are not those of the array."""
    return f"{came[0]} x {came[1]} came, the array is {array.antennas} x {array.subcarriers}"


def usable(block: CsiBlock, rejected: Counters) -> CsiBlock | None:
    """The block without frames that hold NaN or infinity, or nothing but zeros; None if none is left.

    Such frames are counted in `rejected` as `non_finite` and `all_zero`; their neighbours are kept.
    """
    samples = block.csi.reshape(len(block), -1).view(np.float32)
    with np.errstate(all="ignore"):
        sums = samples.sum(axis=1)
    # A sum is finite and not zero for nearly every good frame; only the others are looked at closely.
    suspects = np.flatnonzero(~np.isfinite(sums) | (sums == 0))
    if not len(suspects):
        return block
    finite = np.isfinite(samples[suspects]).all(axis=1)
    zero = ~samples[suspects].any(axis=1)
    for reason, bad in (("non_finite", ~finite), ("all_zero", zero)):
        if bad.any():
            rejected.add(reason, int(bad.sum()))
    keep = np.ones(len(block), bool)
    keep[suspects[~finite | zero]] = False
    if keep.all():
        return block
    return block.take(keep) if keep.any() else None
