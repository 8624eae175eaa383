"""Which options go with which array, and why the others do not."""

from __future__ import annotations

from collections.abc import Iterator

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.options import JOINT, SPECTRAL, Options

MATRIX_LIMIT = 512
"""Methods that need the covariance itself keep N x N numbers a UE; beyond this size they are refused."""
JOINT_LIMIT = 1 << 16
"""N_R N_S up to which the joint method is offered: its spectra take 16 bytes an element and UE."""
JOINT_LEAST = 4
"""Antennas, and subcarriers, below which joint cannot tell paths apart on their axis."""


def misfits(options: Options, array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """Options that do not go with the array: the name of each, and what it must be."""
    if options.theta == JOINT:
        yield from _joint(array)
    else:
        yield from _axis("theta", options.theta, array.antennas, "antennas")
        if options.rho in SPECTRAL:
            yield from _axis("rho", options.rho, array.subcarriers, "subcarriers")
    axes = ((options.theta, array.antennas), (options.rho, array.subcarriers))
    least = min((size for method, size in axes if method in ("music", "minnorm")), default=None)
    order = options.signal_order
    if least is not None and least > 1 and isinstance(order, int) and order >= least:
        yield "signal_order", f"must be below {least}, the number of antennas or subcarriers"


def unreachable(options: Options, array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    """Options that ask for more than the array can give: estimates are made, but not quite those."""
    if "rho_max_m" in options.model_fields_set and options.rho_max_m > array.unambiguous_rho_m * 1.001:
        limit = f"c / array.subcarrier_spacing_hz = {array.unambiguous_rho_m:.1f}"
        yield "rho_max_m", f"must be at most {limit}, where ranges start to repeat"


def _axis(name: str, method: str, size: int, elements: str) -> Iterator[tuple[str, str]]:
    if size < 2 and name == "rho":
        yield name, 'must be "isq" or "lr": with 1 subcarrier there is no delay to see'
    elif size < 2:
        yield name, "needs at least 2 antennas: one alone sees no direction"
    elif method != "bartlett" and size > MATRIX_LIMIT:
        keeps = f"{size} x {size} numbers a UE"
        yield name, f'must be "bartlett": {method} keeps {keeps}, for up to {MATRIX_LIMIT} {elements}'


def _joint(array: ArrayGeometry) -> Iterator[tuple[str, str]]:
    for name, size, elements in (
        ("theta", array.antennas, "antennas"),
        ("rho", array.subcarriers, "subcarriers"),
    ):
        if size < JOINT_LEAST:
            yield name, f'must not be "joint": it takes at least {JOINT_LEAST} {elements}, not {size}'
    if (size := array.antennas * array.subcarriers) > JOINT_LIMIT:
        keeps = "16 bytes an antenna, subcarrier and UE"
        yield "theta", f'must not be "joint": it keeps {keeps}, for up to {JOINT_LIMIT} of them, not {size}'
