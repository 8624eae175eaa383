"""Charts as `foxglove.PointCloud` messages in JSON, which Foxglove's 3D panel draws.

The schema's names are Foxglove's (https://docs.foxglove.dev/docs/sdk/schemas/point-cloud); it takes bytes as
base64 where the schema says so.
"""

from __future__ import annotations

import base64
import time
from typing import Any

import numpy as np

from chachart.node.data.chart import ChartUpdate

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("snr", "<f4"), ("ue", "<f8")])
"""One point of `data`: chart coordinates in metres (z is 0), SNR in dB; `ue` is exact up to 2^53."""

_NUMERIC_TYPES = {"<f4": 7, "<f8": 8}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _numbers(title: str, names: str) -> dict[str, Any]:
    return _object(title, **{name: {"type": "number"} for name in names})


_WHOLE = {"type": "integer", "minimum": 0}
_FIELD = _object("foxglove.PackedElementField", name={"type": "string"}, offset=_WHOLE, type=_WHOLE)
_POSE = _object(
    "foxglove.Pose",
    position=_numbers("foxglove.Vector3", "xyz"),
    orientation=_numbers("foxglove.Quaternion", "xyzw"),
)
SCHEMA = _object(
    "foxglove.PointCloud",
    timestamp=_object("time", sec=_WHOLE, nsec=_WHOLE),
    frame_id={"type": "string"},
    pose=_POSE,
    point_stride=_WHOLE,
    fields={"type": "array", "items": _FIELD},
    data={"type": "string", "contentEncoding": "base64"},
)
"""JSON schema of the messages; its title is the name by which Foxglove knows what they are."""

_FIELDS = [
    {"name": name, "offset": offset, "type": _NUMERIC_TYPES[kind.str]}
    for name, (kind, offset, *_) in (POINT.fields or {}).items()
]


def point_cloud(update: ChartUpdate) -> dict[str, Any]:
    """An update as a point cloud in the frame of the chart, which is named as the array is."""
    points = np.zeros(len(update), POINT)
    for name in ("x", "y", "snr", "ue"):
        points[name] = getattr(update, name)
    sec, nsec = divmod(time.time_ns(), 10**9)
    return {
        "timestamp": {"sec": sec, "nsec": nsec},
        "frame_id": update.array,
        "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
        "point_stride": POINT.itemsize,
        "fields": _FIELDS,
        "data": base64.b64encode(points.tobytes()).decode(),
    }
