"""Chart frames as the page gets them: a JSON header, then raw columns that JavaScript reads in place.

    uint32   length of the header in bytes, little-endian
    header   {"type": "chart", "full": bool, "rows": n, "method": {...}, "columns": [[name, kind], ...]}
    zeros    up to a multiple of 8 bytes from the start
    columns  n values each, little-endian; kind u8 is uint64, f8 float64, f4 float32

A full frame is the whole chart: a UE that it does not name is gone. Any other holds only what has changed.
"""

from __future__ import annotations

import json

import numpy as np

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.geometry import ArrayGeometry

_SHOWN = ("x", "y", "theta", "rho", "theta_std", "rho_std", "snr", "snapshots")


def encode_frame(update: ChartUpdate, array: ArrayGeometry, full: bool) -> bytes:
    """The frame of an update; reference positions become chart coordinates `true_x`, `true_y`."""
    columns = [("ue", "u8", update.ue.astype("<u8")), ("time", "f8", (update.time_ns / 1e6).astype("<f8"))]
    columns += [(name, "f4", getattr(update, name).astype("<f4")) for name in _SHOWN]
    if update.position is None:
        true_x = true_y = np.full(len(update), np.nan)
    else:
        true_x, true_y = array.chart_of(update.position)
    columns += [("true_x", "f4", true_x.astype("<f4")), ("true_y", "f4", true_y.astype("<f4"))]
    header = json.dumps(
        {
            "type": "chart",
            "full": full,
            "rows": len(update),
            "method": {"theta": update.method.theta, "rho": update.method.rho},
            "columns": [[name, kind] for name, kind, _ in columns],
        }
    ).encode()
    head = len(header).to_bytes(4, "little") + header
    head += bytes(-len(head) % 8)
    return b"".join([head, *(values.tobytes() for _, _, values in columns)])
