"""chachart as a library: what is importable from here is public, everything else may change.

The names are imported when they are asked for, so that one does not pay for the others.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from chachart.node.commands.shared.calibrating import calibrate
    from chachart.node.commands.shared.charting import chart_recording
    from chachart.node.data.chart import ChartUpdate
    from chachart.node.data.csi import CsiBlock
    from chachart.node.data.geometry import ArrayGeometry
    from chachart.node.data.version import __version__
    from chachart.node.estimation.estimator import ChartEstimator
    from chachart.node.files.recording import RecordingReader, RecordingWriter
    from chachart.node.net.client import subscribe

__all__ = [
    "ArrayGeometry",
    "ChartEstimator",
    "ChartUpdate",
    "CsiBlock",
    "RecordingReader",
    "RecordingWriter",
    "__version__",
    "calibrate",
    "chart_recording",
    "subscribe",
]

_HOMES = {
    "ArrayGeometry": "data.geometry",
    "ChartEstimator": "estimation.estimator",
    "ChartUpdate": "data.chart",
    "CsiBlock": "data.csi",
    "RecordingReader": "files.recording",
    "RecordingWriter": "files.recording",
    "__version__": "data.version",
    "calibrate": "commands.shared.calibrating",
    "chart_recording": "commands.shared.charting",
    "subscribe": "net.client",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
