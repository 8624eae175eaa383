"""Sample configurations and the table of all settings, made from the settings models."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from chachart.config.describe import allowed, alternatives, literal_values, nested_model, toml
from chachart.config.registry import Kind, available, settings_class
from chachart.config.settings import ArraySettings, QualitySettings, StateSettings, WorkersSettings
from chachart.node.data.alerts import AlertSettings
from chachart.node.data.zones import ZoneSettings
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options
from chachart.node.net.security import SecuritySettings

TABLE_BEGINS = "<!-- settings: made by `chachart config --table` -->"
TABLE_ENDS = "<!-- end of settings -->"

_WIDTH = 100
_KINDS: tuple[Kind, Kind] = ("source", "sink")


def configuration() -> str:
    """A whole configuration with every key at its default; `load` gives the default settings back."""
    parts = [
        _comment(
            "A chachart node's configuration: chachart-node --config THIS_FILE. Every key is at its default."
        ),
        _section("[array]", ArraySettings),
        _others("source"),
        component("source", "simulator"),
        _section("[estimator]", Options),
        _section("[fusion]", FusionOptions),
        _section("[tracking]", TrackingOptions),
        _section("[workers]", WorkersSettings),
        _section("[quality]", QualitySettings),
        _section("[security]", SecuritySettings),
        _section("[state]", StateSettings),
        _comment("[[zones]] and [[alerts]]: any number, none by default; config/SETTINGS.md has their keys."),
        _others("sink"),
        component("sink", "publisher"),
    ]
    return "\n\n".join(parts)


def component(kind: Kind, name: str) -> str:
    """The table of one source or sink.

    Raises
    ------
    SetupError
        If there is none of that name.
    """
    header = "[source]" if kind == "source" else "[[sinks]]"
    return _section(header, settings_class(kind, name), name)


def table() -> str:
    """Every setting of chachart itself as Markdown tables, between two markers that a test looks for."""
    parts = [TABLE_BEGINS]
    for header, model in (
        ("[array]", ArraySettings),
        ("[estimator]", Options),
        ("[fusion]", FusionOptions),
        ("[tracking]", TrackingOptions),
        ("[workers]", WorkersSettings),
        ("[quality]", QualitySettings),
        ("[security]", SecuritySettings),
        ("[state]", StateSettings),
        ("[[zones]]", ZoneSettings),
        ("[[alerts]]", AlertSettings),
    ):
        parts.append(_markdown(f"`{header}`", model))
    for kind, header in zip(_KINDS, ("[source]", "[[sinks]]"), strict=True):
        parts += [
            _markdown(f'`{header}` with `type = "{name}"`', settings_class(kind, name))
            for name in available(kind, package="chachart.")
        ]
    return "\n\n".join([*parts, TABLE_ENDS])


def _others(kind: Kind) -> str:
    names = ", ".join(available(kind))
    return _comment(f"Every {kind}: {names}. `chachart config {kind} NAME` prints its keys.")


def _section(header: str, model: type[BaseModel], type_name: str | None = None) -> str:
    summary = cleandoc(model.__doc__ or "").partition("\n\n")[0]
    lines = [_comment(summary)] if summary else []
    lines.append(header)
    for key, field in _keys(model):
        if key == "type":
            lines.append(f"type = {toml(type_name)}")
            continue
        lines.append(_comment(f"{_meaning(field)} ({allowed(field)})"))
        if field.is_required():
            lines.append(f"{key} = {toml(_example(field))}")
        elif (default := field.get_default(call_default_factory=True)) is None:
            lines.append(f"# {key} = {toml(_example(field))}")
        else:
            lines.append(f"{key} = {toml(default)}")
    return "\n".join(lines)


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Fields by dotted key; those of a nested table one by one, unless something else may stand there."""
    for name, field in model.model_fields.items():
        nested = nested_model(field.annotation)
        if nested is None or len(alternatives(field.annotation)) > 1:
            yield prefix + name, field
        else:
            yield from _keys(nested, f"{prefix}{name}.")


def _meaning(field: FieldInfo) -> str:
    return " ".join((field.description or "").split())


def _example(field: FieldInfo) -> Any:
    """A value that the field would take: a declared example, or one made from what is allowed."""
    if field.examples:
        return field.examples[0]
    if literals := literal_values(field.annotation):
        return literals[0]
    kind = alternatives(field.annotation)[0]
    if get_origin(kind) is tuple:
        return [1.0 for _ in get_args(kind)]
    lowest = next((m.ge for m in field.metadata if hasattr(m, "ge")), 1)
    text = "x" * next((m.min_length for m in field.metadata if hasattr(m, "min_length")), 1)
    return {int: lowest, float: float(lowest), Path: "file", bool: False}.get(kind, text)


def _comment(text: str) -> str:
    return "\n".join(f"# {line}" for line in textwrap.wrap(text, _WIDTH - 2, break_on_hyphens=False))


def _markdown(title: str, model: type[BaseModel]) -> str:
    lines = [f"**{title}**", "", "| key | takes | default | |", "|---|---|---|---|"]
    for key, field in _keys(model):
        if key == "type":
            continue
        default = field.get_default(call_default_factory=True)
        shown = "required" if field.is_required() else "not set" if default is None else f"`{toml(default)}`"
        cells = (f"`{key}`", allowed(field), shown, _meaning(field))
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)
