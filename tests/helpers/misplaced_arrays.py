"""Recordings of arrays that are not quite where, and not quite as late, as they are described."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chachart.node.data import elements as layouts
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.calibrate import spherical
from chachart.node.files.recording import RecordingWriter

HALF_WAVE_M = 299_792_458.0 / 3.5e9 / 2
START_NS = 1_700_000_000_000_000_000
CORNERS = ((-12.0, -12.0), (12.0, -12.0), (12.0, 12.0))


@dataclass(frozen=True)
class Hall:
    """Three boards in corners of a hall: as they are, as they are described, and their clocks."""

    right: tuple[ArrayGeometry, ...]
    described: tuple[ArrayGeometry, ...]
    late_s: tuple[float, ...]


def hall(seed: int = 0, off_m: float = 0.4, off_rad: float = 0.08) -> Hall:
    """Descriptions are off by so much in a random direction, and about a random axis."""
    rng = np.random.default_rng(seed)
    right, described = [], []
    for name, (x, y) in zip("abc", CORNERS, strict=True):
        inwards = np.array([-x, -y, -3.0]) / np.linalg.norm([x, y, 3.0])
        along = np.cross([0.0, 0.0, 1.0], inwards)
        along /= np.linalg.norm(along)
        one = ArrayGeometry.of_elements(
            name,
            layouts.grid(2, 4, HALF_WAVE_M),
            32,
            3.5e9,
            50e6 / 32,
            position_m=(x, y, 4.0),
            axis=tuple(along.tolist()),
            broadside=tuple(inwards.tolist()),
            clock="hall",
        )
        move, turn = rng.standard_normal((2, 3))
        rotation = Rotation.from_rotvec(off_rad * turn / np.linalg.norm(turn))
        place = np.array(one.position_m) + off_m * move / np.linalg.norm(move)
        pose = {"axis": tuple(rotation.apply(one.axis)), "broadside": tuple(rotation.apply(one.broadside))}
        right.append(one)
        described.append(replace(one, position_m=tuple(place.tolist()), **pose))
    return Hall(tuple(right), tuple(described), (8e-9, -21e-9, 33e-9))


def heard(
    array: ArrayGeometry,
    places: NDArray[np.float64],
    late_s: NDArray[np.float64],
    share: float,
    rng: np.random.Generator,
) -> NDArray[np.complex64]:
    """Frames (K, N, S) at 15 dB, of which a share have an echo from elsewhere that is stronger."""
    wave = spherical(array, places)
    wave /= np.abs(wave).mean(axis=(1, 2), keepdims=True)
    echo = spherical(array, places + rng.uniform(-6, 6, places.shape) * (1.0, 1.0, 0.2))
    echo /= np.abs(echo).mean(axis=(1, 2), keepdims=True)
    lost = rng.random(len(places)) < share
    frames = np.where(lost, 0.3, 1.0)[:, None, None] * wave + np.where(lost, 1.0, 0.1)[:, None, None] * echo
    frames = frames * np.exp(-2j * np.pi * late_s[:, None, None] * array.offsets_hz)
    noise = rng.standard_normal((*frames.shape, 2)).view(np.complex128)[..., 0]
    return (frames + noise * np.sqrt(0.5 / 10**1.5)).astype(np.complex64)


def write_recording(
    path: Path,
    there: Hall,
    seed: int,
    own_clocks: bool = False,
    positions: bool = True,
    ues: int = 60,
    echoes: float = 1 / 3,
) -> NDArray[np.float64]:
    """Three transmissions of each of so many UEs; gives their places (U, 3)."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-9, 9, (ues, 2)), rng.uniform(0.5, 2.0, ues)])
    facts = CaptureFacts(delay="relative" if own_clocks else "absolute")
    first, *others = there.described
    with RecordingWriter(path, first, facts=facts, others=others) as writer:
        for turn in range(3):
            own = rng.uniform(0, 200e-9, ues) if own_clocks else np.zeros(ues)
            for one, described, late_s in zip(there.right, there.described, there.late_s, strict=True):
                time_ns = START_NS + turn * 1_000_000_000 + np.arange(ues) * 1_000
                csi = heard(one, places, own + late_s, echoes, rng)
                told = places if positions else None
                writer.write(CsiBlock.of(csi, np.arange(ues), time_ns, told, array=described.name))
    return places
