"""Results as tables for papers and spreadsheets: LaTeX (booktabs) and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def as_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV with a line of headings; None is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: harmless(value) for name, value in row.items()} for row in rows)
    return text.getvalue()


def harmless(value: Any) -> Any:
    """A cell; text that a spreadsheet would take for a formula gets a quote before it."""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"
    return value


def as_latex(rows: Sequence[Row], digits: int = 4) -> str:
    """The rows as a `tabular` with booktabs' rules; numbers to so many significant places after the point."""
    names = list(rows[0])
    kinds = "".join("l" if any(isinstance(row[name], str) for row in rows) else "r" for name in names)
    lines = [
        r"% \usepackage{booktabs}",
        rf"\begin{{tabular}}{{{kinds}}}",
        r"\toprule",
        " & ".join(_escaped(name) for name in names) + r" \\",
        r"\midrule",
        *(" & ".join(_cell(row[name], digits) for name in names) + r" \\" for row in rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _cell(value: Any, digits: int) -> str:
    if value is None:
        return "--"
    if isinstance(value, float):
        return f"{value:.{digits}f}" if abs(value) < 100 else f"{value:.1f}"
    return _escaped(str(value))


def _escaped(text: str) -> str:
    return "".join(f"\\{letter}" if letter in "&%$#_{}" else letter for letter in text)
