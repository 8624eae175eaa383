"""Which machine, interpreter and BLAS a measurement was made on."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np
import scipy

from chachart.node.data.extras import require
from chachart.node.data.version import build


def describe() -> dict[str, str]:
    """Names and versions that a measured number is worth little without.

    Raises
    ------
    SetupError
        If threadpoolctl, which knows the BLAS, is not installed.
    """
    require("bench", "chachart bench:")
    from threadpoolctl import threadpool_info

    return {
        "chachart": build(),
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "blas": "; ".join(sorted({_blas(library) for library in threadpool_info()})) or "unknown",
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    named = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or "unknown processor")


def _blas(library: dict[str, object]) -> str:
    return (
        f"{library['internal_api']} {library['version']} "
        f"({library.get('architecture', 'unknown kernel')}, {library['num_threads']} thread)"
    )
