"""A driver for fsspec whose files are on this machine, and out of reach when a file is not there."""

from __future__ import annotations

import errno
import os
from typing import Any

from fsspec.implementations.local import LocalFileSystem

UP = "OUTAGE_UP"
"""The variable of the environment that names the file."""


class Outage(LocalFileSystem):  # type: ignore[misc]
    """What URLs `outage:///folder` lead to."""

    protocol = ("outage",)

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(LocalFileSystem._strip_protocol(path.removeprefix("outage://")))

    def info(self, path: str, **options: Any) -> Any:
        """What there is at a path."""
        _reach()
        return super().info(path, **options)

    def ls(self, path: str, detail: bool = False, **options: Any) -> Any:
        """What there is in a folder."""
        _reach()
        return super().ls(path, detail, **options)

    def _open(self, path: str, mode: str = "rb", **options: Any) -> Any:
        _reach()
        return super()._open(path, mode, **options)


def _reach() -> None:
    if not os.path.exists(os.environ[UP]):
        raise OSError(errno.ENETDOWN, "the network is down")
