"""Which source measures with which arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from chachart.config.settings import ArraySettings
from chachart.sources.base import SourceSettings


@dataclass(frozen=True, slots=True)
class FeedSettings:
    """A source and the arrays that it measures with; none where it must carry its own."""

    source: SourceSettings
    arrays: tuple[ArraySettings, ...]


def paired(sources: Sequence[SourceSettings], arrays: Sequence[ArraySettings]) -> tuple[FeedSettings, ...]:
    """Each source with its arrays: those that it names, or the one in the same place.

    Raises
    ------
    ValueError
        If names are not different, there is no such array, or an array has no source or two.
    """
    named = {array.name: array for array in arrays}
    if len(named) < len(arrays):
        raise ValueError(f"[[array]]: names must be different, not {', '.join(a.name for a in arrays)}")
    feeds = []
    for n, source in enumerate(sources):
        wanted = source.array
        if wanted is None:
            wanted = tuple(array.name for array in arrays[n : n + 1])
        elif isinstance(wanted, str):
            wanted = (wanted,)
        for name in wanted:
            if name not in named:
                there = ", ".join(f'"{one}"' for one in named) or "none"
                raise ValueError(f'source.{source.type}.array = "{name}": must be one of {there}')
        feeds.append(FeedSettings(source, tuple(named[name] for name in wanted)))
    used = [array.name for feed in feeds for array in feed.arrays]
    for name in named:
        if (count := used.count(name)) != 1:
            what = "no source measures" if not count else f"{count} sources measure"
            raise ValueError(f'[[array]] "{name}": {what} with it (array in [[source]] says which does)')
    return tuple(feeds)
