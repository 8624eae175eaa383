"""Reports as the plain values that JSON and msgpack can hold, and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import orjson

_OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS


def plain(value: Any) -> Any:
    """The same with plain numbers and lists; what is not finite becomes None, as JSON has no word for it."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(v) for key, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain_array(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value


def encoded(value: Any) -> bytes:
    """The value as JSON, arrays as lists; `null` where a number is not finite."""
    try:
        return orjson.dumps(value, default=plain, option=_OPTIONS)
    except TypeError:  # a whole number of more than 64 bits, a text with half a surrogate pair, ...
        return json.dumps(plain(value)).encode()


def _plain_array(values: np.ndarray[Any, Any]) -> Any:
    """As lists, None where not finite; number by number only where there is something to replace."""
    if values.dtype.kind in "iub" or (values.dtype.kind == "f" and np.isfinite(values).all()):
        return values.tolist()
    return plain(values.tolist())
