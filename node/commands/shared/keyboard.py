"""Keys as they are pressed, for commands that fill a terminal."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def typed() -> Iterator[Callable[[], str]]:
    """A function that gives what has been typed since it was asked last, without waiting.

    Where stdin is no terminal nothing is ever typed. Ctrl-C goes on to interrupt.
    """
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield lambda: _waiting(descriptor)
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _waiting(descriptor: int) -> str:
    ready, _, _ = select.select([descriptor], [], [], 0)
    return os.read(descriptor, 1024).decode(errors="replace") if ready else ""
