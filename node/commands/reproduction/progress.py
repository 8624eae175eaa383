"""Progress of a long command: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LINE_EVERY_S = 2.0


@contextmanager
def steps(total: int) -> Iterator[Callable[[str], None]]:
    """A function to tell of each of `total` steps that is done, in words; writes to stderr.

    Where stderr is no terminal, a line says so every `LINE_EVERY_S` at most, and at the end.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("beginning", total=total)
            yield lambda words: bar.update(task, advance=1, description=words)
        return
    start = told = time.monotonic()
    done = 0

    def line(words: str) -> None:
        nonlocal done, told
        done += 1
        now = time.monotonic()
        if now - told >= LINE_EVERY_S or done == total:
            told = now
            print(f"[{done}/{total}] {now - start:.0f} s: {words}", file=sys.stderr, flush=True)

    yield line
