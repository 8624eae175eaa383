"""`section.key=value` from a command line, put into a parsed TOML document."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

Location = tuple[str | int, ...]


def apply(document: dict[str, Any], overrides: Sequence[str]) -> tuple[dict[Location, str], list[str]]:
    """Change `document` in place; what was set, by place, and a line for each override that makes no sense.

    A value is read as TOML, and as plain text where it is none. A sink is addressed by its number or by its
    type, as in `sinks.0.endpoint` or `sinks.publisher.endpoint`. Another `type` of source or sink takes the
    place of the whole table, since the keys of the one mean nothing to the other.
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
    if keys[0] != "sinks":
        return tuple(keys)
    sinks = document.get("sinks")
    sinks = sinks if isinstance(sinks, list) else []
    types = [sink.get("type") if isinstance(sink, dict) else None for sink in sinks]
    listed = ", ".join(str(kind) for kind in types) or "none"
    if keys[1].isdigit():
        numbers = [int(keys[1])] if int(keys[1]) < len(types) else []
    else:
        numbers = [n for n, kind in enumerate(types) if kind == keys[1]]
    if not numbers:
        raise LookupError(f'there is no sink "{keys[1]}"; the configuration has {listed}')
    if len(numbers) > 1:
        raise LookupError(
            f'several sinks are "{keys[1]}", say which by its number, from 0; the configuration has {listed}'
        )
    if len(keys) < 3:
        raise LookupError(f"must name a key of the sink, as in sinks.{keys[1]}.key=value")
    return ("sinks", numbers[0], *keys[2:])


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
