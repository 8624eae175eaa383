"""A first guess of an array's pose: the one that most of its frames agree with.

Any frame's strongest path may be an echo, so poses are tried that few frames each ask for (RANSAC; Fischler
and Bolles, Comm. ACM 24(6), 1981).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chachart.node.estimation.fusion.heard import OFFSET, PARAMETERS, Heard, Pose
from chachart.node.estimation.fusion.site import Floats

TRIES = 60
"""Random sets of frames ..."""
AT_A_TIME = 4
"""... of so many, and steps that each is fitted by."""
TRY_STEPS = 8
ENOUGH = 2000
"""Frames that a try is judged by, and offsets are found from."""
DOUBTFUL_RAD, DOUBTFUL_CELLS = 0.1, 0.15
"""Deviations that sets of frames are judged by."""
MOST_OFF = 4.685
"""Frames that are further off than so many deviations squared are echoes, however far they are."""


def guess(heard: Heard, free: list[int], with_offset: bool) -> Pose:
    """The pose that most frames agree with.

    Parameters
    ----------
    heard
        What the array has heard.
    free
        Which parameters are looked for.
    with_offset
        Whether delays tell distances but for a constant; if not, angles alone count.
    """
    rng = np.random.default_rng(0)
    count = len(heard.event)
    some = rng.choice(count, min(ENOUGH, count), replace=False)
    best, least = heard.described, np.inf
    for n in range(TRIES if 0 in free else 1):
        pose, which = heard.described, some
        if n:
            which = rng.choice(count, min(AT_A_TIME, count), replace=False)
            if n % 3 == 0:  # mounted another way round
                turn = Rotation.from_euler("XYZ", rng.integers(0, 4, 3) * np.pi / 2).as_matrix()
                pose = Pose(pose.middle, turn @ pose.frame)
        if with_offset:
            pose = pose.late(heard.typical(pose, which))
        if 0 in free:
            pose = _fitted(heard, pose, [p for p in free if p != OFFSET or with_offset], with_offset, which)
            if with_offset:
                pose = pose.late(heard.typical(pose, some))
        square = (heard.off(pose) / _doubtful(heard))[some, : None if with_offset else -1] ** 2
        told = float(np.minimum(square.mean(axis=1), MOST_OFF).mean())
        if told < least:
            best, least = pose, told
    return best


def _fitted(heard: Heard, pose: Pose, free: list[int], with_offset: bool, which: NDArray[np.intp]) -> Pose:
    """The pose after some damped steps by few frames."""
    scale = _doubtful(heard)
    columns = slice(None) if with_offset else slice(0, heard.angles)
    prior = np.diag(np.array([*[0.3] * OFFSET, 0.0])[free])
    few = heard.some(which)
    for _ in range(TRY_STEPS):
        r = (few.off(pose) / scale)[:, columns].reshape(-1)
        a = (few.slopes(pose) / scale[:, None])[:, columns][:, :, free].reshape(-1, len(free))
        move = np.zeros(PARAMETERS)
        move[free] = np.clip(np.linalg.lstsq(a.T @ a + prior, -a.T @ r, rcond=None)[0], -1.0, 1.0)
        pose = pose.moved(move)
    return pose


def _doubtful(heard: Heard) -> Floats:
    return np.append(np.full(heard.angles, DOUBTFUL_RAD), DOUBTFUL_CELLS * heard.cell_m)
