"""What fits into this machine's memory, and into one message."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.options import Options
from chachart.node.net.wire import MAX_CSI_BYTES

SHARE = 0.8
"""Of the memory, for the state of the estimators."""
ROW_BYTES = 1024
"""What tables of newest rows keep of a UE, in worker and main process."""

_CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def memory_bytes() -> int:
    """Physical memory that this process may use: the machine's, or its container's where that is less."""
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        limit = _CGROUP_LIMIT.read_text().strip()
    except OSError:
        return whole
    return min(whole, int(limit)) if limit.isdigit() else whole


def frame_problems(array: ArrayGeometry) -> Iterator[str]:
    """Why frames of the array do not fit."""
    if 8 * array.antennas * array.subcarriers > MAX_CSI_BYTES:
        size = f"{array.antennas} antennas x {array.subcarriers} subcarriers"
        yield f"[array]: a frame of {size} is larger than {MAX_CSI_BYTES >> 20} MiB, the most in one message"


def capacity_problems(estimator: ChartEstimator, options: Options) -> Iterator[str]:
    """Why the UEs that the options allow do not fit."""
    array = estimator.array
    size = f"{array.antennas} antennas x {array.subcarriers} subcarriers"
    ue_bytes = estimator.bytes_per_ue + ROW_BYTES
    room = SHARE * memory_bytes()
    if options.max_ues * ue_bytes > room:
        yield (
            f"[estimator]: max_ues = {options.max_ues} takes {_text(options.max_ues * ue_bytes)} of memory "
            f"({_text(ue_bytes)} a UE: {options.theta} and {options.rho} of {size}); "
            f"{_text(room)} are there: at most {int(room // ue_bytes)}"
        )


def _text(size: float) -> str:
    for unit in ("B", "KiB", "MiB"):
        if size < 1024:
            return f"{size:.0f} {unit}"
        size /= 1024
    return f"{size:.1f} GiB"
