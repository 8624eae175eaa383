"""Cells and structs in MATLAB files of version 7.3, which are HDF5: references to what they hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from chachart.sources.formats.wifi.bf_file import Frame, is_frame

if TYPE_CHECKING:
    import h5py

CELLS = "MATLAB v7.3 .mat of read_bf_file"

_DEEPEST = 8
"""Cells and structs within each other."""
_MOST = 1 << 20
"""Numbers in one field of a frame."""


def frames(opened: h5py.File) -> list[Frame]:
    """The frames of read_bf_file of the Intel 5300's tool, in cells or in arrays of structs.

    With them comes what else has their fields, for others to count; nothing where there is no frame.
    """
    found = list(_frames(opened))
    return found if any(map(is_frame, found)) else []


def _frames(opened: h5py.File) -> Iterator[Frame]:
    seen: set[int] = set()
    for name in opened:
        if not name.startswith("#") and _is_inside(opened, name):
            yield from _structs(opened[name], opened, 0, seen)


def _is_inside(group: h5py.Group, name: str) -> bool:
    """Whether a member is in this very file."""
    import h5py

    return group.get(name, getlink=True).__class__ is h5py.HardLink


def _structs(item: Any, opened: h5py.File, depth: int, seen: set[int]) -> Iterator[Frame]:
    """The structs in a variable: itself, an array of them (fields are references), or cells of them.

    What was `seen` (by its place in the file) is not looked into again: damage makes circles.
    """
    import h5py

    if depth > _DEEPEST or not isinstance(item, h5py.Dataset | h5py.Group):
        return
    place = h5py.h5o.get_info(item.id).addr
    if place in seen:
        return
    seen.add(place)
    if isinstance(item, h5py.Dataset):
        if _is_references(item):
            for held in _held(item, opened):
                yield from _structs(held, opened, depth + 1, seen)
        return
    members = {name: item[name] for name in item if _is_inside(item, name)}
    csi = members.get("csi")
    if isinstance(csi, h5py.Dataset) and _is_references(csi):
        fields = {
            name: list(_held(member, opened))
            for name, member in members.items()
            if isinstance(member, h5py.Dataset) and _is_references(member)
        }
        for row in range(len(fields["csi"])):
            each = {name: values[row] for name, values in fields.items() if row < len(values)}
            yield _numbers(each)
    elif csi is not None:
        yield _numbers(members)
    else:
        for member in members.values():
            yield from _structs(member, opened, depth + 1, seen)


def _is_references(item: h5py.Dataset) -> bool:
    import h5py

    return h5py.check_ref_dtype(item.dtype) is h5py.Reference


def _held(item: h5py.Dataset, opened: h5py.File) -> Iterator[Any]:
    """What an array of references refers to, in MATLAB's order."""
    for reference in np.ravel(np.asarray(item[()]))[:_MOST]:
        yield opened[reference] if reference else None


def _numbers(members: dict[str, Any]) -> Frame:
    """The fields of a struct that are numbers, with the axes as MATLAB has them."""
    from chachart.sources.formats.hdf5_file import as_complex, check_storage

    found: Frame = {}
    for name, member in members.items():
        kind = getattr(member, "dtype", None)
        if kind is None or (kind.names is None and kind.kind not in "iuf") or member.size > _MOST:
            continue
        check_storage(member)
        if member.attrs.get("MATLAB_empty", 0):
            continue
        values = as_complex(np.asarray(member[()]))
        if values.dtype.names is None:
            found[name] = values.T
    return found
