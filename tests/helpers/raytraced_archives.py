"""An archive of ray-traced channels, as it could be: three boards in line of sight of two UEs that walk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

LIGHT = 299_792_458.0
TONES = 32


def write_archive(path: Path) -> Path:
    """Write it, 30 steps of .1 s a UE."""
    steps, tracks = 30, 2
    frequencies = 3.5e9 + (np.arange(TONES) - TONES // 2) * 50e6 / TONES
    half = LIGHT / 3.5e9 / 2
    frames, elements = [], []
    for x, y in ((-15.0, -15.0), (15.0, -15.0), (0.0, 18.0)):
        normal = np.array([-x, -y, 0.0]) / np.hypot(x, y)
        up = np.array([0.0, 0.0, 1.0])
        right = np.cross(up, normal)
        frames.append(np.stack([normal, right, up], axis=1))
        elements.append(
            [[x, y, 3.0] + half * ((c - 1.5) * right + (0.5 - r) * up) for r in (0, 1) for c in range(4)]
        )
    places = np.array(elements)
    time_s = np.tile(np.arange(steps) * 0.1, tracks)
    track = np.repeat(np.arange(tracks), steps)
    position = np.column_stack([-3 + 1.3 * time_s, 4.0 - 6.0 * track, np.full(len(track), 1.5)])
    far = np.linalg.norm(position[:, None, None] - places, axis=-1)
    h = np.exp(-2j * np.pi * far[..., None] * frequencies / LIGHT) / far[..., None]
    scale = np.abs(h).max(axis=(2, 3)) / 500
    scaled = h / scale[:, :, None, None]
    np.savez(
        path,
        iq=np.round(np.stack([scaled.real, scaled.imag], axis=-1)).astype(np.int16),
        iq_scale=scale.astype(np.float32),
        freqs=frequencies,
        elements=places,
        array_R=np.array(frames),
        position=position,
        track=track.astype(np.int32),
        time=time_s,
        area=np.array([-12.0, 12.0, -12.0, 12.0]),
    )
    return path
