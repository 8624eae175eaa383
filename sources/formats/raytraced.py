"""Channels of several arrays in one `.npz` archive, as ray tracers' data sets have them.

`iq` (U, B, N, S, 2) are scaled samples of U UE positions at B arrays, `iq_scale` (U, B) their scales, `freqs`
(S,) the frequencies in hertz, `elements` (B, N, 3) world positions, `array_R` (B, 3, 3) the arrays' normal,
right and up as columns, `position` (U, 3) where the UEs are. Moving UEs have `track` (U,) and `time` (U,) in
seconds. `area` (x0, x1, y0, y1) or `room` says where UEs can be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.formats.base import Capture

NEEDED = ("iq", "iq_scale", "freqs", "elements", "array_R", "position")
CLOCK = "common"
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class SeveralArrays:
    """What such an archive holds.

    Attributes
    ----------
    arrays
        The arrays, `A`, `B` and so on, by one clock.
    csi
        complex64 (K, B, N, S), without noise.
    ue, time_s
        Whose frame each is, and when it was sent.
    position
        float64 (K, 3).
    area_m
        Lower and higher corner of where UEs can be, or None.
    """

    arrays: list[ArrayGeometry]
    csi: NDArray[np.complex64]
    ue: NDArray[np.uint64]
    time_s: NDArray[np.float64]
    position: NDArray[np.float64]
    area_m: tuple[float, float, float, float] | None

    def noisy(self, snr_db: float, rng: np.random.Generator) -> NDArray[np.complex64]:
        """The CSI with white noise at `snr_db` below what each UE's strongest array receives on average."""
        power = (np.abs(self.csi) ** 2).mean(axis=(2, 3)).max(axis=1) / 10 ** (snr_db / 10)
        noise = rng.standard_normal((*self.csi.shape, 2), np.float32).view(np.complex64)[..., 0]
        found: NDArray[np.complex64] = self.csi + noise * np.sqrt(power / 2)[:, None, None, None].astype(
            np.float32
        )
        return found


def is_raytraced(capture: Capture) -> bool:
    """Whether a capture is such an archive."""
    return all(name in capture.variables for name in NEEDED)


def read_raytraced(capture: Capture, rate_hz: float) -> SeveralArrays:
    """All of it; UEs that stand have a frame each, `rate_hz` of them a second.

    Raises
    ------
    SetupError
        If shapes do not go together or tones are uneven.
    """
    q, scale = capture.read("iq"), capture.read("iq_scale")
    if q.ndim != 5 or q.shape[4] != 2 or scale.shape != q.shape[:2]:
        raise SetupError(f"{capture.path}: iq must be (UE, array, element, tone, 2) and iq_scale (UE, array)")
    position = np.asarray(capture.read("position"), np.float64)
    csi = np.ascontiguousarray(q, np.float32).view(np.complex64)[..., 0]
    csi *= scale[:, :, None, None].astype(np.float32)
    moving = "track" in capture.variables and "time" in capture.variables
    frames = len(q)
    if position.shape != (frames, 3):
        raise SetupError(f"{capture.path}: position must be ({frames}, 3), not {position.shape}")
    ue = capture.read("track").astype(np.uint64) if moving else np.arange(frames, dtype=np.uint64)
    time_s = np.asarray(capture.read("time"), np.float64) if moving else np.arange(frames) / rate_hz
    order = np.argsort(time_s, kind="stable")
    return SeveralArrays(
        _arrays(capture, position, q.shape[3]),
        csi[order],
        ue[order],
        time_s[order],
        position[order],
        _area(capture),
    )


def _arrays(capture: Capture, position: NDArray[np.float64], tones: int) -> list[ArrayGeometry]:
    frequencies = np.asarray(capture.read("freqs"), np.float64)
    elements, turned = capture.read("elements"), capture.read("array_R")
    steps = np.diff(frequencies)
    if len(frequencies) != tones or tones < 2 or not np.allclose(steps, steps[0], rtol=1e-6):
        raise SetupError(f"{capture.path}: freqs must be {tones} even frequencies")
    if len(elements) > len(LETTERS):
        raise SetupError(f"{capture.path}: {len(elements)} arrays are more than {len(LETTERS)}")
    middle = tones // 2
    level = float(position[0, 2])
    arrays = []
    for name, places, frame in zip(LETTERS, elements, turned, strict=False):
        normal, right, up = np.asarray(frame, np.float64).T
        centre = places.mean(axis=0)
        arrays.append(
            ArrayGeometry.of_elements(
                name,
                np.round((places - centre) @ np.stack([right, up, normal], axis=1), 9),
                tones,
                float(frequencies[middle]),
                float(steps[0]),
                position_m=tuple(centre.tolist()),
                axis=tuple(right.tolist()),
                broadside=tuple(normal.tolist()),
                tones=tuple(range(-middle, tones - middle)),
                height_m=abs(float(centre[2]) - level) if np.allclose(position[:, 2], level) else None,
                clock=CLOCK,
            )
        )
    return arrays


def _area(capture: Capture) -> tuple[float, float, float, float] | None:
    for name in ("room", "area"):
        if name in capture.variables:
            x0, x1, y0, y1 = np.asarray(capture.read(name), np.float64)[:4].tolist()
            return (x0, y0, x1, y1)
    return None
