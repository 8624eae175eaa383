"""`section.key=value` from a command line, put into a parsed TOML document."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

Location = tuple[str | int, ...]

LABELS = {"sinks": "type", "source": "type", "array": "name", "zones": "name", "alerts": "name"}
LISTED = ("sinks", "zones", "alerts")
"""Sections that may stand there several times, and the key by which one of them is called."""


def apply(document: dict[str, Any], overrides: Sequence[str]) -> tuple[dict[Location, str], list[str]]:
    """Change `document` in place; what was set, by place, and a line for each override that makes no sense.

    A value is read as TOML, and as plain text where it is none. A sink is addressed by its number or by its
    type, as in `sinks.0.endpoint` or `sinks.publisher.endpoint`, and so is one of several sources; one of
    several arrays by its number or name. Another `type` of source or sink takes the place of the whole table,
    since the keys of the one mean nothing to the other.
    """
    applied: dict[Location, str] = {}
    mistakes: list[str] = []
    parsed = []
    for text in overrides:
        dotted, equals, raw = text.partition("=")
        keys = [key.strip() for key in dotted.split(".")]
        if not equals or len(keys) < 2 or not all(keys):
            mistakes.append(f"--set {text}: must look like section.key=value")
        else:
            parsed.append((text, keys, parse_value(raw.strip())))
    for text, keys, value in sorted(parsed, key=lambda one: one[1][-1] != "type"):
        try:
            location = _locate(document, keys)
            _put(document, location, value)
        except LookupError as error:
            mistakes.append(f"--set {text}: {error.args[0]}")
        else:
            applied[location] = text
    return applied, mistakes


def parse_value(text: str) -> Any:
    """A value in TOML's syntax, or `text` itself where it is none.

    >>> parse_value("4"), parse_value("[1, 2]"), parse_value("capture.mcap")
    (4, [1, 2], 'capture.mcap')
    """
    try:
        document = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return document["value"] if len(document) == 1 else text


def _locate(document: dict[str, Any], keys: list[str]) -> Location:
    section = keys[0]
    tables = document.get(section)
    if section not in LABELS or (section not in LISTED and not isinstance(tables, list)):
        return tuple(keys)
    noun, label = section.removesuffix("s"), LABELS[section]
    tables = tables if isinstance(tables, list) else []
    labels = [table.get(label) if isinstance(table, dict) else None for table in tables]
    listed = ", ".join(str(name) for name in labels) or "none"
    if keys[1].isdigit():
        numbers = [int(keys[1])] if int(keys[1]) < len(labels) else []
    else:
        numbers = [n for n, name in enumerate(labels) if name == keys[1]]
    if not numbers:
        raise LookupError(f'there is no {noun} "{keys[1]}"; the configuration has {listed}')
    if len(numbers) > 1:
        which = "say which by its number, from 0"
        raise LookupError(f'several {noun}s are "{keys[1]}", {which}; the configuration has {listed}')
    if len(keys) < 3:
        raise LookupError(f"must name a key of the {noun}, as in {section}.{keys[1]}.key=value")
    return (section, numbers[0], *keys[2:])


def _put(document: dict[str, Any], location: Location, value: Any) -> None:
    table: Any = document
    for step in location[:-1]:
        table = table.setdefault(step, {}) if isinstance(table, dict) else table[step]
        if not isinstance(table, dict | list):
            raise LookupError(f"{step} is a value, not a table")
    key = location[-1]
    if not isinstance(table, dict):
        raise LookupError(f"{location[-2]} is a list, not a table")
    if key == "type" and table.get("type") not in (None, value):
        table.clear()
    table[key] = value
