"""Chart frames as the page gets them: a JSON header, then raw columns that JavaScript reads in place.

    uint32   length of the header in bytes, little-endian
    header   {"type": "chart", "full": bool, "rows": n, "method": {...}, "columns": [[name, kind], ...]}
    zeros    up to a multiple of 8 bytes from the start
    columns  n values each, little-endian; kind u8 is uint64, i8 int64, f4 float32, u4 uint32, i4 int32

A full frame is the whole chart: a UE that it does not name is gone. Any other holds only what has changed.
"""

from __future__ import annotations

import json
from typing import Any

from numpy.typing import NDArray

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS
from chachart.node.data.geometry import ArrayGeometry

_BYTES = {"u8": 8, "i8": 8, "f4": 4, "u4": 4, "i4": 4}


def encode_frame(update: ChartUpdate, array: ArrayGeometry, full: bool) -> bytes:
    """The frame of an update; reference positions are also there in chart coordinates, `true_x`, `true_y`."""
    columns = [(name, *_raw(name, values)) for name, values in update.flat().items()]
    if update.position is not None:
        true = zip(("true_x", "true_y"), update.truth_of(array), strict=True)
        columns += [(name, *_raw(name, values)) for name, values in true]
    columns.sort(key=lambda column: -_BYTES[column[1]])  # the wide ones first: all are aligned
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
    return b"".join([head, *(raw for _, _, raw in columns)])


def describe() -> list[dict[str, Any]]:
    """What the page has to know of the columns that may come, one entry a flat column."""
    flat = [(name, column) for column in COLUMNS.values() for name, _ in column.flat(column.missing(0))]
    flat += [(name, COLUMNS["x"]) for name in ("true_x", "true_y")]
    return [
        {
            "name": name,
            "file_name": column.file_name(name),
            "label": column.label,
            "unit": column.unit,
            "decimals": column.decimals,
        }
        for name, column in flat
    ]


def _raw(name: str, values: NDArray[Any]) -> tuple[str, bytes]:
    """Kind and bytes of a column: 4 bytes a number, but 8 for UEs and times."""
    width = 8 if name in ("ue", "time_ns") else 4
    kind = f"{values.dtype.kind}{width}"
    return kind, values.astype(f"<{kind}").tobytes()
