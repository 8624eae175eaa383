"""Folders of whole files: a file appears when all of it is there. Here those of this machine."""

from __future__ import annotations

import contextlib
import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import IO

UNFINISHED = ".new"
"""How the name ends of what is being written."""


class FolderError(OSError):
    """A folder cannot be reached, or refuses: what is in it is not known."""


class Folder(ABC):
    """A folder and the files in it. All methods raise OSError where something cannot be done."""

    name: str

    @abstractmethod
    def __str__(self) -> str:
        """Path or URL."""

    @abstractmethod
    def problems(self) -> list[str]:
        """Why it cannot be written to, or made, by several processes; nothing if it can."""

    @abstractmethod
    def child(self, name: str) -> Folder:
        """A folder in this one, there or not."""

    @abstractmethod
    def make(self) -> None:
        """Make it, and what it is in; no mistake where it is there."""

    @abstractmethod
    def is_there(self) -> bool:
        """Whether there is such a folder."""

    @abstractmethod
    def files(self) -> dict[str, float]:
        """Names of the files in it, and when they changed, since 1970; none where it is not there."""

    @abstractmethod
    def folders(self) -> list[str]:
        """Names of the folders in it."""

    @abstractmethod
    def open(self, name: str) -> contextlib.AbstractContextManager[IO[bytes]]:
        """A file to read anywhere in."""

    @abstractmethod
    def write(
        self,
        name: str,
        fill: Callable[[IO[bytes]], None],
        durable: bool,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Write a file in place of what is there; what was there stays if anything goes wrong.

        Parameters
        ----------
        name
            Of the file.
        fill
            Writes what is to be in it.
        durable
            Whether it must outlive the machine, not only the process.
        wanted
            Asked at the very end; where it says no, what was there stays.
        """

    @abstractmethod
    def remove(self, name: str) -> None:
        """Take a file away."""

    @abstractmethod
    def remove_all(self) -> None:
        """Take away the folder and what is in it, as far as that is possible."""


class LocalFolder(Folder):
    """A folder of this machine.

    Parameters
    ----------
    path
        Where it is.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.name

    def __str__(self) -> str:
        path = str(self.path)
        return f"./{path}" if ":" in path and not self.path.is_absolute() else path

    def problems(self) -> list[str]:
        """See `Folder`."""
        there = self.path if self.path.exists() else self.path.parent
        if not there.is_dir():
            return [f"{there} is not a folder that is there"]
        return [] if os.access(there, os.W_OK) else [f"{there} cannot be written to"]

    def child(self, name: str) -> LocalFolder:
        """See `Folder`."""
        return LocalFolder(self.path / name)

    def make(self) -> None:
        """See `Folder`."""
        self.path.mkdir(parents=True, exist_ok=True)

    def is_there(self) -> bool:
        """See `Folder`."""
        return self.path.is_dir()

    def files(self) -> dict[str, float]:
        """See `Folder`."""
        found = {}
        for path in self.path.glob("*"):
            with contextlib.suppress(FileNotFoundError):  # it may go meanwhile
                if path.is_file():
                    found[path.name] = path.stat().st_mtime
        return found

    def folders(self) -> list[str]:
        """See `Folder`."""
        return [path.name for path in self.path.glob("*") if path.is_dir()]

    def open(self, name: str) -> IO[bytes]:
        """See `Folder`."""
        return (self.path / name).open("rb")

    def write(
        self,
        name: str,
        fill: Callable[[IO[bytes]], None],
        durable: bool,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """See `Folder`."""
        new = self.path / f"{name}{UNFINISHED}"
        try:
            with new.open("wb") as file:
                fill(file)
                file.flush()
                if durable:
                    os.fsync(file.fileno())
            if not wanted():
                new.unlink()
                return
            new.replace(self.path / name)
        except BaseException:
            with contextlib.suppress(OSError):
                new.unlink()
            raise
        if durable:
            folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def remove(self, name: str) -> None:
        """See `Folder`."""
        (self.path / name).unlink()

    def remove_all(self) -> None:
        """See `Folder`."""
        shutil.rmtree(self.path, ignore_errors=True)
