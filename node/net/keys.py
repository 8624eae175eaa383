"""CURVE keys in files: the node's own, and those of everybody who may connect.

A folder of keys, which `[security] keys` names, holds `node.key_secret` (the node's own pair, readable by its
owner only), `node.key` (what everybody who connects must know of it), and one folder for each right:
`read/` (may subscribe and ask), `steer/` (may also steer), `send/` (may send CSI), with a `NAME.key` for
everybody who has it. Keys that are added or taken away count for whoever connects from then on.
"""

from __future__ import annotations

import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self, get_args

import zmq
import zmq.auth

from chachart.node.data.errors import SetupError

Right = Literal["read", "steer", "send"]
RIGHTS: tuple[Right, ...] = get_args(Right)
NODE = "node"
MOST_KEYS = 10_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_Z85 = re.compile(rb"[0-9A-Za-z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public and a secret CURVE key, in Z85."""

    public: bytes
    secret: bytes = field(repr=False)

    @classmethod
    def load(cls, path: Path) -> Self:
        """The pair in a `NAME.key_secret` file.

        Raises
        ------
        SetupError
            If it cannot be read, others may read it, or it holds no pair.
        """
        try:
            mode = path.stat().st_mode
        except OSError as error:
            raise SetupError(f"cannot read {path}: {error.strerror}") from None
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise SetupError(f"{path} holds a secret that others may read: chmod 600 {path}")
        public, secret = _load(path)
        if secret is None:
            raise SetupError(f"{path} holds no secret key; `chachart keys new NAME` makes NAME.key_secret")
        return cls(public, secret)


def load_public(path: Path) -> bytes:
    """The public key in a `NAME.key` file.

    Raises
    ------
    SetupError
        If it cannot be read or holds none.
    """
    return _load(path)[0]


def new_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """Make a pair of keys; paths of the public and of the secret file. The folder is made where needed.

    Raises
    ------
    SetupError
        If the name cannot be one, is taken, or the files cannot be written.
    """
    _check_name(name)
    public, secret = folder / f"{name}.key", folder / f"{name}.key_secret"
    for path in (public, secret):
        if path.exists():
            raise SetupError(f"{path} is there already; keys are never overwritten")
    mask = os.umask(0o077)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        zmq.auth.create_certificates(folder, name)
        public.chmod(0o644)
    except OSError as error:
        raise SetupError(f"cannot write {public}: {error.strerror}") from None
    finally:
        os.umask(mask)
    return public, secret


def allow(folder: Path, key: Path, right: Right) -> Path:
    """Let whoever has the secret of this public key connect; the file that says so.

    Raises
    ------
    SetupError
        If the key cannot be read, or the file cannot be written.
    """
    public = load_public(key)
    _check_name(key.stem)
    target = folder / right / f"{key.stem}.key"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(f'curve\n    public-key = "{public.decode()}"\n')
    except OSError as error:
        raise SetupError(f"cannot write {target}: {error.strerror}") from None
    return target


class KeyRing:
    """Who may connect to a node: the keys in the folders of some rights, read again when they change.

    Parameters
    ----------
    folder
        The folder of keys.
    rights
        Rights that let one in, weakest first; the last one found counts.
    """

    def __init__(self, folder: Path, rights: tuple[Right, ...]) -> None:
        self._folders = [(right, folder / right) for right in rights]
        self._stamp: list[tuple[str, int, int]] = []
        self._names: dict[bytes, tuple[Right, str]] = {}

    def who(self, public: bytes) -> tuple[Right, str] | None:
        """Right and name of whoever has this key (Z85), or None."""
        stamp = [_stamp(path) for _, folder in self._folders for path in folder.glob("*.key")]
        if stamp != self._stamp:
            self._names = dict(self._read())
            self._stamp = stamp
        return self._names.get(public)

    def _read(self) -> list[tuple[bytes, tuple[Right, str]]]:
        found: list[tuple[bytes, tuple[Right, str]]] = []
        for right, folder in self._folders:
            for path in sorted(folder.glob("*.key"))[:MOST_KEYS]:
                try:
                    found.append((load_public(path), (right, path.stem)))
                except SetupError:  # a file that is being written, or no key: it lets nobody in
                    continue
        return found


def serve_with(socket: zmq.Socket[Any], pair: KeyPair) -> None:
    """Make a socket a CURVE server; before it is bound."""
    socket.curve_server = True
    socket.curve_publickey, socket.curve_secretkey = pair.public, pair.secret


def connect_with(socket: zmq.Socket[Any], key: Path | str | None, server_key: Path | str | None) -> None:
    """Make a socket a CURVE client with the pair in `key` of the server whose public key is in `server_key`.

    Nothing happens where neither is given.

    Raises
    ------
    SetupError
        If only one is given, or one cannot be read.
    """
    if key is None and server_key is None:
        return
    if key is None or server_key is None:
        raise SetupError("a key and the server's key go together: NAME.key_secret and node.key")
    pair = KeyPair.load(Path(key))
    socket.curve_publickey, socket.curve_secretkey = pair.public, pair.secret
    socket.curve_serverkey = load_public(Path(server_key))


def _load(path: Path) -> tuple[bytes, bytes | None]:
    try:
        if path.stat().st_size > 64 * 1024:
            raise ValueError("it is too long")
        public, secret = zmq.auth.load_certificate(path)
        if not all(_Z85.fullmatch(key) for key in (public, secret) if key is not None):
            raise ValueError("a key has 40 characters of Z85")
    except (ValueError, IndexError) as error:
        raise SetupError(f"{path} holds no CURVE key: {error}") from None
    except OSError as error:
        raise SetupError(f"cannot read {path}: {error.strerror or error}") from None
    return public, secret


def _stamp(path: Path) -> tuple[str, int, int]:
    """Changes when the file does."""
    try:
        state = path.stat()
    except OSError:
        return str(path), 0, 0
    return str(path), state.st_mtime_ns, state.st_ino


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise SetupError(f"{name!r} names no key: letters, digits, dots, dashes and underscores do")
