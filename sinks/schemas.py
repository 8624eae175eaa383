"""JSON schemas of what is logged and shown: a chart, a quality report, a status report."""

from __future__ import annotations

from typing import Any

from chachart.node.data.columns import COLUMNS, Column

_NUMBER = {"type": ["number", "null"]}


def schemas() -> dict[str, dict[str, Any]]:
    """The JSON schema of each kind of message."""
    method = {"type": "object", "properties": {"theta": {"type": "string"}, "rho": {"type": "string"}}}
    chart = {
        "title": "chachart.chart",
        "description": "One row a UE; null where a value is unknown.",
        "type": "object",
        "properties": {
            "array": {"type": "string"},
            "method": method,
            **{column.name: _schema(column) for column in COLUMNS.values()},
        },
        "required": ["array", "method", *(c.name for c in COLUMNS.values() if not c.optional)],
    }
    quality, status = ({"title": f"chachart.{kind}", "type": "object"} for kind in ("quality", "status"))
    return {"chart": chart, "quality": quality, "status": status}


def _schema(column: Column) -> dict[str, Any]:
    row = {"type": "array", "items": _NUMBER} if column.parts else _NUMBER
    unit = f" In {column.unit}." if column.unit else ""
    return {"type": "array", "items": row, "description": f"{column.about}{unit}"}
