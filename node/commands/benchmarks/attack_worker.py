"""Throws mutated inputs at a decoder, in a process of bounded memory and with bounded time for each input."""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from chachart.node.commands.benchmarks.attack_inputs import DECODERS
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.data.errors import SetupError

LONGEST_S = 2.0
"""A decoder that is at the same input for longer is stuck."""
MEMORY_BYTES = 2 << 30
"""Address space of the process."""
MOST_GROWTH_BYTES = 128 << 20


class Stuck(BaseException):
    """An input took longer than it may; what catches any `Exception` does not catch this."""


@dataclass(frozen=True, slots=True)
class Thrown:
    """How many inputs were taken, in how many seconds, and by how many bytes memory grew."""

    taken: int
    seconds: float
    grown: int


def bound() -> None:
    """Take this process no more memory than it may have."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def throw(name: str, seed: int, first: int, count: int) -> Thrown:
    """Decode inputs `first` to `first + count` of a seed.

    Raises
    ------
    SetupError
        If one gave anything but a value or a clean error, or took too much time or memory.
    """
    decoder = DECODERS[name]()
    decode, refusals = decoder.decode, decoder.refusals
    taken, n = 0, first
    before, begin = _peak(), time.monotonic()
    try:
        with _watched(lambda: n):
            for n, data in enumerate(mutations(decoder.samples, seed, first, count), first):  # noqa: B007
                try:
                    decode(data)
                    taken += 1
                except refusals:
                    pass
    except BaseException as error:
        raise SetupError(f"{name}, input {n} of seed {seed}: {error!r}") from error
    grown = _peak() - before
    if grown > MOST_GROWTH_BYTES:
        raise SetupError(f"{name}, inputs {first} to {n} of seed {seed}: {grown / 1e6:.0f} MB more")
    return Thrown(taken, time.monotonic() - begin, grown)


@contextmanager
def _watched(at: Callable[[], int]) -> Iterator[None]:
    """Raise `Stuck` where `at` says the same twice in a row; setting an alarm for each input is slow."""
    seen = -1

    def look(number: int, frame: FrameType | None) -> None:
        nonlocal seen
        if at() == seen:
            raise Stuck(f"longer than {LONGEST_S} s")
        seen = at()

    old = signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
