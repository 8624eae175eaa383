"""Settings models in words: what a field allows, and its values as TOML. For errors, samples and tables."""

from __future__ import annotations

import json
import types
from collections.abc import Iterator, Mapping
from datetime import date, time
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types as limits
from pydantic import BaseModel
from pydantic.fields import FieldInfo

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
            text = repr(value)
            mantissa, e, exponent = text.partition("e")
            return f"{mantissa}e{int(exponent)}" if e else text
        case str() | Path():
            return json.dumps(str(value), ensure_ascii=False)
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
    words = " and ".join(_limits(metadata))
    return f" {words}" if words else ""


def _limits(metadata: list[Any]) -> Iterator[str]:
    for m in metadata:
        match m:
            case limits.Gt(gt=value):
                yield f"> {value}"
            case limits.Ge(ge=value):
                yield f">= {value}"
            case limits.Lt(lt=value):
                yield f"< {value}"
            case limits.Le(le=value):
                yield f"<= {value}"
            case limits.MinLen(min_length=value):
                yield f"at least {value} long"
            case limits.MaxLen(max_length=value):
                yield f"at most {value} long"
            case _ if pattern := getattr(m, "pattern", None):
                yield f"like {pattern}"
