"""Which options go with which array, and why the others do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from chachart.node.data.elements import lattice, partners
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.lattice import Lattice
from chachart.node.estimation.options import AUTO, JOINT, NONE, SPECTRAL, Options

MATRIX_LIMIT = 512
"""Methods that need the covariance itself keep N x N numbers a UE; beyond this size they are refused."""
JOINT_LIMIT = 1 << 16
"""N_R N_S up to which the joint method is offered: its spectra take 16 bytes an element and UE."""
JOINT_LOBE = 0.5
"""Power of side lobes, for a path of power 1, up to which joint can tell them from paths."""
JOINT_LEAST = 4
"""Antennas, and subcarriers, below which joint cannot tell paths apart on their axis."""


def misfits(options: Options, array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """Options that do not go with the array: the name of each, and what it must be."""
    antennas, tones = Lattice.of_antennas(array)[0], Lattice.of_tones(array)[0]
    if not array.is_uniform:
        antennas = Lattice.even(int(array.live_antennas.sum()))
        yield from _directions(options, array)
    if options.theta == JOINT:
        yield from _joint(antennas, tones)
    elif options.rho == AUTO:
        for _, problem in _joint(antennas, tones):
            yield "rho", problem.replace(JOINT, AUTO, 1)
    for name, method, row, elements in (
        ("theta", options.theta, antennas, "antennas"),
        ("rho", options.rho, tones, "subcarriers"),
    ):
        if method in SPECTRAL:
            yield from _axis(name, method, row.size, elements)
            if options.forward_backward and not row.symmetric:
                yield "forward_backward", f"must be off: these {elements} are not their own mirror image"
    if options.delay == "relative" and options.rho in (*SPECTRAL, JOINT, AUTO):
        yield (
            "rho",
            f'must be "none", "isq" or "lr": {options.rho} takes delays for distances, and those of this '
            "capture are of packet detection",
        )
    if options.smoothing < 1:
        for name, method, row in (("theta", options.theta, antennas), ("rho", options.rho, tones)):
            if method in SPECTRAL[1:] and not row.dense and (name == "rho" or array.is_uniform):
                yield "smoothing", f"must be 1: the elements of the {name} axis leave gaps"
    axes = ((options.theta, antennas.size), (options.rho, tones.size))
    least = min((size for method, size in axes if method in ("music", "minnorm")), default=None)
    order = options.signal_order
    if least is not None and least > 1 and isinstance(order, int) and order >= least:
        yield "signal_order", f"must be below {least}, the number of antennas or subcarriers"


def unreachable(options: Options, array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """Options that ask for more than the array can give: estimates are made, but not quite those."""
    if "rho_max_m" in options.model_fields_set and options.rho_max_m > array.unambiguous_rho_m * 1.001:
        yield "rho_max_m", f"must be at most {array.unambiguous_rho_m:.1f}, where ranges start to repeat"


def _directions(options: Options, array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """What does not go with an array that is no uniform line."""
    own = array.own_elements[array.live_antennas]
    if array.pattern is not None:
        for name, off in (
            ("forward_backward", not options.forward_backward),
            ("smoothing", options.smoothing == 1),
        ):
            if not off:
                yield name, "must be off: elements with patterns of their own do not look alike"
    if options.theta != NONE and not array.is_line:
        spread = np.linalg.svd(own - own.mean(axis=0), compute_uv=False) if len(own) > 1 else np.zeros(1)
        if len(own) < 3 or spread[1] < 1e-3 * spread[0]:
            yield "theta", 'must be "none": elements on one line see an angle if axis is along that line'
    if options.forward_backward and options.theta in SPECTRAL and partners(own) is None:
        yield "forward_backward", "must be off: these elements are not symmetric about their middle"
    if options.smoothing < 1 and options.theta in (*SPECTRAL[1:],) and lattice(own) is None:
        yield "smoothing", "must be 1: sub-arrays that look alike take a line or a board"


def _axis(name: str, method: str, size: int, elements: str) -> Iterator[tuple[str, str]]:
    if size < 2 and name == "rho":
        yield name, 'must be "isq", "lr" or "none": with 1 subcarrier there is no delay to see'
    elif size < 2:
        yield name, 'must be "none": one antenna alone sees no direction'
    elif method != "bartlett" and size > MATRIX_LIMIT:
        keeps = f"{size} x {size} numbers a UE"
        yield name, f'must be "bartlett": {method} keeps {keeps}, for up to {MATRIX_LIMIT} {elements}'


def _joint(antennas: Lattice, tones: Lattice) -> Iterator[tuple[str, str]]:
    for name, size, elements in (("theta", antennas.size, "antennas"), ("rho", tones.size, "subcarriers")):
        if size < JOINT_LEAST:
            yield name, f'must not be "joint": it takes at least {JOINT_LEAST} {elements}, not {size}'
        lobe = (antennas if name == "theta" else tones).side_lobe
        if size >= JOINT_LEAST and lobe > JOINT_LOBE:
            yield (
                name,
                f'must not be "joint": side lobes of these {elements} have {lobe:.0%} of a path\'s power',
            )
    if (size := antennas.span * tones.span) > JOINT_LIMIT:
        keeps = "16 bytes an antenna, subcarrier and UE"
        yield "theta", f'must not be "joint": it keeps {keeps}, for up to {JOINT_LIMIT} of them, not {size}'
