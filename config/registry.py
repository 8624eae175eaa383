"""Sources and sinks by name: entry points `chachart.sources` and `chachart.sinks`, imported when used."""

from __future__ import annotations

from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Literal

from chachart.node.data.errors import SetupError
from chachart.sinks.base import Sink, SinkSettings
from chachart.sources.base import Source, SourceSettings

Kind = Literal["source", "sink"]


def available(kind: Kind, package: str = "") -> list[str]:
    """Names of all sources or sinks that installed packages offer, sorted; of one package if given."""
    return sorted({e.name for e in _entries(kind) if e.value.startswith(package)})


def source_class(name: str) -> type[Source]:
    """The source called `name`.

    Raises
    ------
    SetupError
        If there is none, or its package cannot be loaded.
    """
    loaded = _load("source", name)
    if not (
        isinstance(loaded, type) and issubclass(loaded, Source) and _has_settings(loaded, SourceSettings)
    ):
        raise SetupError(f'source "{name}": {loaded!r} is no chachart.sources.base.Source with Settings')
    return loaded


def sink_class(name: str) -> type[Sink]:
    """The sink called `name`.

    Raises
    ------
    SetupError
        If there is none, or its package cannot be loaded.
    """
    loaded = _load("sink", name)
    if not (isinstance(loaded, type) and issubclass(loaded, Sink) and _has_settings(loaded, SinkSettings)):
        raise SetupError(f'sink "{name}": {loaded!r} is no chachart.sinks.base.Sink with Settings')
    return loaded


def settings_class(kind: Kind, name: str) -> type[SourceSettings] | type[SinkSettings]:
    """The settings model of a source or sink.

    Raises
    ------
    SetupError
        If there is none, or its package cannot be loaded.
    """
    return source_class(name).Settings if kind == "source" else sink_class(name).Settings


def suggestion(wrong: object, right: list[str]) -> str:
    """`; did you mean "right"?` where one of `right` is close to `wrong`, else nothing."""
    close = get_close_matches(str(wrong), right, n=1, cutoff=0.6)
    return f'; did you mean "{close[0]}"?' if close else ""


def _entries(kind: Kind) -> list[EntryPoint]:
    return list(entry_points(group=f"chachart.{kind}s"))


def _load(kind: Kind, name: str) -> object:
    entries = {e.value: e for e in _entries(kind) if e.name == name}
    if not entries:
        names = available(kind)
        listed = ", ".join(f'"{n}"' for n in names)
        raise SetupError(f'there is no {kind} "{name}", only {listed}{suggestion(name, names)}')
    if len(entries) > 1:
        raise SetupError(f'{kind} "{name}" is offered more than once: by {" and by ".join(sorted(entries))}')
    [entry] = entries.values()
    try:
        loaded: object = entry.load()
    except Exception as error:
        raise SetupError(
            f'{kind} "{name}" cannot be loaded from {entry.value}: {type(error).__name__}: {error}'
        ) from error
    return loaded


def _has_settings(cls: type, base: type) -> bool:
    settings = getattr(cls, "Settings", None)
    return isinstance(settings, type) and issubclass(settings, base)
