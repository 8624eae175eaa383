"""Variables of a capture, whatever their order of axes, as frames that the node can take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.sources.formats.clock import unwrapped

AXES = ("ue", "frame", "antenna", "subcarrier", "iq")
"""What an axis of CSI can be; `frame` counts those of each UE, `iq` holds real and imaginary part."""

_ORDER = ("ue", "frame", "antenna", "subcarrier")


def taken(csi: NDArray[Any], axes: Sequence[str], cuts: Mapping[str, int]) -> tuple[NDArray[Any], list[str]]:
    """CSI cut at one index of each axis in `cuts`, and the names of the axes that are left.

    >>> taken(np.zeros((2, 3, 4)), ["rx", "ue", "subcarrier"], {"rx": 1})[1]
    ['ue', 'subcarrier']

    Raises
    ------
    ValueError
        If an axis is not there, or is shorter than that.
    """
    rest = list(axes)
    for name, index in cuts.items():
        if name not in rest:
            raise ValueError(f'there is no axis "{name}" to take {index} of, only {",".join(rest)}')
        place = rest.index(name)
        length = csi.shape[place] if place < csi.ndim else 1
        if index >= length:
            raise ValueError(f'axis "{name}" has {length} entries, there is no {index}')
        csi = np.take(csi, index, place) if place < csi.ndim else csi
        rest.pop(place)
    for name in [name for name in rest if name not in AXES]:
        place = rest.index(name)
        if place >= csi.ndim or csi.shape[place] == 1:
            csi = csi if place >= csi.ndim else np.take(csi, 0, place)
            rest.pop(place)
        elif csi.ndim <= len(axes):
            known = ", ".join(AXES)
            raise ValueError(
                f'axes are {known}, there is no "{name}": --take {name}=0 picks one of {csi.shape[place]}'
            )
    return csi, rest


def frames(csi: NDArray[Any], axes: Sequence[str]) -> NDArray[np.complex64]:
    """CSI whose axes are named, as complex64 (frames, antennas, subcarriers).

    The frames of a UE follow one another. A missing axis means one: one UE, one antenna, one subcarrier.
    Trailing axes that `axes` names beyond those of `csi` mean one too, since MATLAB drops them.

    Raises
    ------
    ValueError
        If names and shape do not go together, or the values are not complex numbers.
    """
    if unknown := [name for name in axes if name not in AXES]:
        raise ValueError(f'axes are {", ".join(AXES)}, there is no "{unknown[0]}"')
    if len(set(axes)) != len(axes):
        raise ValueError(f"each axis may be named once, not {','.join(axes)}")
    if csi.ndim > len(axes):
        raise ValueError(f"{csi.ndim} axes of lengths {csi.shape} need as many names, not {','.join(axes)}")
    csi = csi.reshape(csi.shape + (1,) * (len(axes) - csi.ndim))
    names = list(axes)
    if "iq" in names:
        csi = _complex(np.moveaxis(csi, names.index("iq"), -1))
        names.remove("iq")
    elif csi.dtype.kind != "c":
        raise ValueError(f"complex values are needed, not {csi.dtype} (or an axis iq of length 2)")
    if 0 in csi.shape:
        raise ValueError(f"there is nothing in it, its shape is {csi.shape}")
    present = [name for name in _ORDER if name in names]
    ordered = np.transpose(csi, [names.index(name) for name in present])
    lengths = dict(zip(present, ordered.shape, strict=True))
    with np.errstate(over="ignore"):
        ue, frame, antenna, subcarrier = (lengths.get(name, 1) for name in _ORDER)
        return np.ascontiguousarray(ordered, np.complex64).reshape(ue * frame, antenna, subcarrier)


def defects(csi: NDArray[np.complex64]) -> NDArray[np.str_]:
    """What is wrong with each frame of (frames, antennas, subcarriers), empty where nothing is."""
    flat = csi.reshape(len(csi), -1)
    found = np.full(len(csi), "", "U16")
    if flat.shape[1] > 1:
        found[(flat == flat[:, :1]).all(axis=1)] = "is constant"
    found[~flat.any(axis=1)] = "is all zero"
    found[~np.isfinite(flat).all(axis=1)] = "is not finite"
    return found


def positions(values: NDArray[Any], count: int, z_m: float) -> NDArray[np.float32]:
    """Reference positions as float32 (count, 3) in metres; `z_m` completes those that have x and y only.

    Raises
    ------
    ValueError
        If the shape fits neither (count, 2 or 3) nor its transpose, or a value is infinite.
    """
    if values.ndim == 2 and values.shape[0] in (2, 3) and values.shape[1] == count != values.shape[0]:
        values = values.T
    if values.shape not in ((count, 2), (count, 3)) or values.dtype.kind not in "fiu":
        raise ValueError(f"must be numbers of shape ({count}, 3), not {values.dtype} {values.shape}")
    if np.isinf(values).any():
        raise ValueError("must be finite, or NaN where unknown")
    full = np.full((count, 3), z_m, np.float32)
    full[:, : values.shape[1]] = values
    return full


def column(values: NDArray[Any], count: int, each: int = 1) -> NDArray[Any]:
    """One value a frame, as (count,); one a UE where each UE has `each` frames one after another.

    Raises
    ------
    ValueError
        If there are not so many.
    """
    if each > 1 and values.size == count // each:
        values = np.repeat(values.ravel(), each)
    if each > 1 and values.size == count:
        values = values.ravel()
    if values.size != count or max(values.shape, default=1) != count:
        raise ValueError(f"must have one value for each of {count} frames, not shape {values.shape}")
    flat: NDArray[Any] = values.reshape(count)
    return flat


def identities(values: NDArray[Any]) -> NDArray[np.uint64]:
    """UE numbers as uint64.

    Raises
    ------
    ValueError
        If they are not whole numbers from 0 on.
    """
    whole = values.dtype.kind in "iu" or (
        values.dtype.kind == "f" and bool((values == np.floor(values)).all())
    )
    if not whole or (values < 0).any():
        raise ValueError(f"must be whole numbers from 0 on, not {values.dtype} such as {values[0]}")
    return values.astype(np.uint64)


def occurrence(ue: NDArray[np.uint64]) -> NDArray[np.int64]:
    """For each frame, how many frames of the same UE came before it.

    >>> occurrence(np.array([7, 7, 3, 7], np.uint64)).tolist()
    [0, 1, 0, 2]
    """
    order = np.argsort(ue, kind="stable")
    _, first, counts = np.unique(ue[order], return_index=True, return_counts=True)
    ranks = np.empty(len(ue), np.int64)
    ranks[order] = np.arange(len(ue)) - np.repeat(first, counts)
    return ranks


TIME_UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Nanoseconds in a unit of time."""


def times_ns(values: NDArray[Any], unit: str | None = None) -> NDArray[np.int64]:
    """Times as int64 nanoseconds: in `unit` if given, else whole numbers are nanoseconds, others seconds.

    Unsigned numbers of less than 64 bits are a counter, which wraps around; a step back stays a step back.

    Raises
    ------
    ValueError
        If they are not finite numbers, or too large.
    """
    if values.dtype.kind in "iu":
        tick = TIME_UNITS[unit or "ns"]
        if values.dtype.kind == "u" and values.dtype.itemsize < 8 and len(values):
            values = unwrapped(values, 8 * values.dtype.itemsize)
        if len(values) and max(abs(int(values.min())), abs(int(values.max()))) > (1 << 63) // tick - 1:
            raise ValueError(f"reach to {values.max()} {unit or 'ns'}, beyond what 64 bits of ns hold")
        return values.astype(np.int64) * tick
    scale = TIME_UNITS[unit or "s"]
    if (
        values.dtype.kind != "f"
        or not np.isfinite(values).all()
        or np.abs(values).max() * (scale / 1e9) > 9e9
    ):
        raise ValueError(f"must be nanoseconds (whole numbers) or seconds, not {values.dtype} {values[0]}")
    ticks = np.floor(values)
    times: NDArray[np.int64] = ticks.astype(np.int64) * scale
    times += np.rint((values - ticks) * scale).astype(np.int64)
    return times


def _complex(pairs: NDArray[Any]) -> NDArray[Any]:
    if pairs.shape[-1] != 2 or pairs.dtype.kind not in "fiu":
        raise ValueError(f"axis iq must hold 2 real numbers, not {pairs.shape[-1]} of {pairs.dtype}")
    whole = np.empty(pairs.shape[:-1], np.complex128)
    whole.real, whole.imag = pairs[..., 0], pairs[..., 1]
    return whole
