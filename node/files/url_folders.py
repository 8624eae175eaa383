"""Folders wherever a URL leads: fsspec opens them, whose drivers are packages of their own (`s3:` is s3fs).

A file is written under another name and then gets its own: at once where the file system can rename, else
as a copy, which object stores show when it is whole. Who reads must notice what is torn.
"""

from __future__ import annotations

import contextlib
import errno
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import IO, Any
from urllib.parse import unquote

from chachart.node.data.errors import SetupError
from chachart.node.data.extras import require
from chachart.node.files.folders import UNFINISHED, Folder, FolderError, LocalFolder

_SCHEME = re.compile(r"([a-z][a-z0-9+.-]+):", re.IGNORECASE)
"""Of a URL; a single letter is none, and a path may begin with `./`."""
_PIECE = 1 << 20
_PROBE = f"check{UNFINISHED}"


def folder_at(place: str | Path) -> Folder:
    """The folder at a path or URL; nothing is opened or made.

    Raises
    ------
    SetupError
        If fsspec or its driver is missing, or there is none for such URLs.
    """
    found = None if isinstance(place, Path) else _SCHEME.match(place)
    if found is None:
        return LocalFolder(Path(place))
    scheme, url = found[1].lower(), str(place)
    if scheme == "file":
        path = re.sub(r"^//(localhost)?(?=/)", "", url[found.end() :])
        if not path.startswith("/") or path.startswith("//"):
            raise SetupError(
                f"{url}: a file: URL names a folder of this machine, as file:///var/lib/chachart"
            )
        return LocalFolder(Path(unquote(path)))
    if not url[found.end() :].startswith("//"):
        raise SetupError(
            f"{url}: a URL goes on with two slashes: {scheme}://{url[found.end() :].lstrip('/')}"
        )
    require("state", f"{url}:")
    return RemoteFolder(url)


class RemoteFolder(Folder):
    """A folder that fsspec reaches. Each call looks anew: others write there, and processes fork.

    Parameters
    ----------
    url
        Where it is; what its driver must know besides comes from that driver's usual environment and files.

    Raises
    ------
    SetupError
        If there is no driver for it.
    """

    def __init__(self, url: str) -> None:
        scheme, _, rest = url.partition("://")
        self.url = f"{scheme}://{rest.rstrip('/')}"
        self.name = self.url.rpartition("/")[2]
        from fsspec import get_filesystem_class

        try:
            get_filesystem_class(_scheme(url))
        except ImportError as error:
            raise SetupError(f"{url}: {_first_line(error)}") from None
        except ValueError:
            raise SetupError(f"{url}: fsspec knows no {_scheme(url)}: file system") from None

    def __str__(self) -> str:
        return self.url

    def problems(self) -> list[str]:
        """See `Folder`; a file is written and taken away again where that is the only way to know."""
        if _scheme(self.url) == "memory":
            return [
                "memory: is of each process alone: what one writes is gone with it; name a folder or a URL"
            ]
        try:
            with self._system() as (system, path):
                there = _is_folder(system, path)
                if not (there or _is_folder(system, path.rpartition("/")[0])):
                    return ["neither it nor what it would be in is there"]
                if there:
                    system.pipe_file(f"{path}/{_PROBE}", b"")
                    system.rm_file(f"{path}/{_PROBE}")
        except OSError as error:
            return [f"{error.strerror}"]
        return []

    def child(self, name: str) -> RemoteFolder:
        """See `Folder`."""
        return RemoteFolder(f"{self.url}/{name}")

    def make(self) -> None:
        """See `Folder`."""
        with self._system() as (system, path):
            system.makedirs(path, exist_ok=True)

    def is_there(self) -> bool:
        """See `Folder`."""
        with self._system() as (system, path):
            system.invalidate_cache()
            return _is_folder(system, path)

    def files(self) -> dict[str, float]:
        """See `Folder`."""
        return {name: _changed(entry) for name, entry in self._entries() if entry["type"] == "file"}

    def folders(self) -> list[str]:
        """See `Folder`."""
        return [name for name, entry in self._entries() if entry["type"] == "directory"]

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        """See `Folder`; it is fetched first."""
        with tempfile.TemporaryFile() as fetched:
            with self._system() as (system, path), system.open(f"{path}/{name}", "rb") as remote:
                shutil.copyfileobj(remote, fetched, _PIECE)
            fetched.seek(0)
            yield fetched

    def write(
        self,
        name: str,
        fill: Callable[[IO[bytes]], None],
        durable: bool,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """See `Folder`; `durable` is up to the file system."""
        with tempfile.TemporaryFile() as written:
            fill(written)
            written.seek(0)
            with self._system() as (system, path):
                new = f"{path}/{name}{UNFINISHED}"
                try:
                    with system.open(new, "wb") as remote:
                        shutil.copyfileobj(written, remote, _PIECE)
                    if wanted():
                        _rename(system, new, f"{path}/{name}")
                    else:
                        system.rm_file(new)
                except BaseException:
                    with contextlib.suppress(Exception):  # the first failure is the one to tell
                        system.rm_file(new)
                    raise

    def remove(self, name: str) -> None:
        """See `Folder`."""
        with self._system() as (system, path):
            system.rm_file(f"{path}/{name}")

    def remove_all(self) -> None:
        """See `Folder`."""
        with contextlib.suppress(OSError):
            for name in self.folders():
                self.child(name).remove_all()
            with self._system() as (system, path):
                for name in self.files():
                    system.rm_file(f"{path}/{name}")
                system.rmdir(path)

    def _entries(self) -> list[tuple[str, dict[str, Any]]]:
        with self._system() as (system, path):
            system.invalidate_cache()
            try:
                entries = system.ls(path, detail=True)
            except FileNotFoundError:
                return []
        named = [(str(entry["name"]).rstrip("/").rpartition("/")[2], entry) for entry in entries]
        return [(name, entry) for name, entry in named if name and name != self.name]

    @contextlib.contextmanager
    def _system(self) -> Iterator[tuple[Any, str]]:
        """The file system and the path in it; whatever its driver raises is an OSError that says why.

        Raises
        ------
        FileNotFoundError
            If it was reached, and what was looked for is not there.
        FolderError
            If anything else went wrong.
        """
        from fsspec.core import url_to_fs

        try:
            yield url_to_fs(self.url)
        except FileNotFoundError as error:
            raise FileNotFoundError(errno.ENOENT, error.strerror or _first_line(error)) from error
        except OSError as error:
            number = error.errno or (errno.EACCES if isinstance(error, PermissionError) else errno.EIO)
            raise FolderError(number, error.strerror or _first_line(error)) from error
        except Exception as error:  # drivers raise what the libraries below them do
            raise FolderError(errno.EIO, _first_line(error)) from error


def _scheme(url: str) -> str:
    return url.partition(":")[0].lower()


def _is_folder(system: Any, path: str) -> bool:
    """What fsspec's own `isdir` says, but for failures, which that takes for a no."""
    try:
        return bool(system.info(path)["type"] == "directory")
    except FileNotFoundError:
        return False


def _rename(system: Any, old: str, new: str) -> None:
    """Give a file its name. fsspec's own way to move takes brackets in names for patterns."""
    from fsspec import AbstractFileSystem

    if type(system).mv is not AbstractFileSystem.mv:
        system.mv(old, new)
    else:
        system.cp_file(old, new)
        system.rm_file(old)


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def _changed(entry: dict[str, Any]) -> float:
    """When a file changed, by whatever name its driver tells it; 0 where it does not."""
    for key in ("mtime", "LastModified", "last_modified", "updated", "modified", "created"):
        match entry.get(key):
            case int() | float() as seconds:
                return float(seconds)
            case datetime() as time:
                return time.timestamp()
    return 0.0
