"""Tables of results: printed for people, plain values for JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from rich.console import Console
from rich.table import Table as RichTable

from chachart.node.commands.benchmarks.timing import Timing, number, plain

Cell = str | int | float | Timing | None


@dataclass(slots=True)
class Table:
    """One table of a benchmark. A cell of None could not be measured; a note says why."""

    title: str
    columns: list[str]
    rows: list[list[Cell]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *cells: Cell) -> None:
        """Add a row, one cell a column."""
        if len(cells) != len(self.columns):
            raise ValueError(f"{self.title}: {len(cells)} cells for {len(self.columns)} columns")
        self.rows.append(list(cells))

    def show(self, console: Console) -> None:
        """Print."""
        table = RichTable(title=self.title, title_justify="left", title_style="bold")
        for n, column in enumerate(self.columns):
            table.add_column(column, justify="left" if n == 0 else "right")
        for row in self.rows:
            table.add_row(*map(_text, row))
        console.print(table)
        for note in self.notes:
            console.print(f"  {note}", highlight=False)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "title": self.title,
            "rows": [dict(zip(self.columns, map(plain, row), strict=True)) for row in self.rows],
            "notes": self.notes,
        }


def _text(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, float):
        return number(cell)
    return f"{cell:,}" if isinstance(cell, int) else str(cell)
