"""Settings models in words: what a field allows, and its values as TOML. For errors, samples and tables."""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from datetime import date, time
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from chachart.node.data.settings import Means

_PLAIN = {bool: "true or false", int: "a whole number", float: "a number", str: "text", Path: "a path"}


def allowed(field: FieldInfo) -> str:
    """What may stand in a field, as a phrase: `a number > 0`, `one of "a", "b", or 3 numbers`."""
    words = [_phrase(kind) for kind in alternatives(field.annotation) if get_origin(kind) is not Literal]
    if literals := literal_values(field.annotation):
        named = ", ".join(toml(v) for v in literals)
        words.append(named if len(literals) == 1 else f"one of {named}")
    if words:
        words[0] += _bounds(field.metadata)
    return " or ".join(words)


def alternatives(annotation: Any) -> list[Any]:
    """The members of a union, None left out; any other annotation is its own only member."""
    if get_origin(annotation) in (Union, types.UnionType):
        return [kind for member in get_args(annotation) for kind in alternatives(member)]
    return [] if annotation is type(None) else [annotation]


def literal_values(annotation: Any) -> list[Any]:
    """All values that the Literal members of an annotation name."""
    return [v for kind in alternatives(annotation) if get_origin(kind) is Literal for v in get_args(kind)]


def nested_model(annotation: Any) -> type[BaseModel] | None:
    """The settings model among an annotation's alternatives, if any."""
    for kind in alternatives(annotation):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def toml(value: Any) -> str:
    """A value as TOML writes it.

    >>> toml(("a", 1.0, True))
    '["a", 1.0, true]'
    """
    match value:
        case bool():
            return "true" if value else "false"
        case int() | date() | time():
            return str(value)
        case float():
            short = f"{value:g}"
            text = short if "e" in short and float(short) == value else repr(value)
            mantissa, e, exponent = text.partition("e")
            return f"{mantissa}e{int(exponent)}" if e else text
        case str() | Path():
            return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
        case Mapping():
            return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + " }"
        case BaseModel():
            return toml(value.model_dump(exclude_none=True))
        case tuple() | list():
            return "[" + ", ".join(toml(v) for v in value) + "]"
    raise TypeError(f"{value!r} has no place in a TOML file")


def _phrase(kind: Any) -> str:
    if get_origin(kind) is Annotated:
        base, *metadata = get_args(kind)
        inner = [m for outer in metadata for m in getattr(outer, "metadata", [outer])]
        return _phrase(base) + _bounds(inner)
    if kind in _PLAIN:
        return _PLAIN[kind]
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "a table"
    members = get_args(kind)
    if get_origin(kind) in (tuple, list) and members:
        if len(members) == 1 or members[-1] is Ellipsis:
            return f"a list (of {_phrase(members[0])} each)"
        if len(set(members)) == 1 and members[0] in (int, float):
            return f"{len(members)} numbers"
        return "[" + ", ".join(_phrase(m) for m in members) + "]"
    if get_origin(kind) is dict:
        return "a table"
    return str(getattr(kind, "__name__", kind))


def _bounds(metadata: list[Any]) -> str:
    """Limits in words, with a leading space: ` from 1 to 64`, ` > 0`, or what a pattern means."""
    found: dict[str, Any] = {}
    for m in metadata:
        if isinstance(m, Means):
            return f" {m.text}"
        for name in ("gt", "ge", "lt", "le", "min_length", "max_length"):
            if (value := getattr(m, name, None)) is not None:
                found[name] = _number(value)
    words = []
    if "ge" in found and "le" in found:
        words.append(f"from {found.pop('ge')} to {found.pop('le')}")
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    words += [f"{sign} {found[name]}" for name, sign in signs.items() if name in found]
    if "min_length" in found and "max_length" in found:
        words.append(f"{found.pop('min_length')} to {found.pop('max_length')} long")
    lengths = {"min_length": "at least", "max_length": "at most"}
    words += [f"{phrase} {found[name]} long" for name, phrase in lengths.items() if name in found]
    return " " + " and ".join(words) if words else ""


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else toml(float(value))
