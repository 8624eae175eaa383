"""Errors that speak to the person who runs chachart."""

from __future__ import annotations

EX_CONFIG = 78
"""Exit status of a node that was told something it cannot do (sysexits.h)."""


class SetupError(Exception):
    """Something a user asked for cannot be: a missing file, a port in use, a shape that does not fit.

    The message is one complete line that says which, where and what would be right; commands print it
    without a traceback and exit with `EX_CONFIG`.
    """


class RequestError(ValueError):
    """A request to a running node that it cannot fulfil; the message says why, in one line."""
