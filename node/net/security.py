"""`[security]`: who gets in, and how much one may ask. The same rules for page, HTTP, control and sockets."""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Self

from pydantic import Field

from chachart.node.data.errors import SetupError
from chachart.node.data.settings import Settings
from chachart.node.net.endpoints import is_local

SHORTEST_TOKEN = 16
TOKEN_VARIABLE, READ_TOKEN_VARIABLE = "CHACHART_TOKEN", "CHACHART_READ_TOKEN"
_ASKS_TOO_MUCH = 4096
"""A longer text is no token; nobody hashes a megabyte for a stranger."""


class SecuritySettings(Settings):
    """`[security]`: who gets in, and how much one may ask. Without a token, people on this machine alone."""

    token: str | None = Field(None, min_length=SHORTEST_TOKEN, repr=False)
    """Whoever knows it may ask and steer; once set, everybody needs one. Or $CHACHART_TOKEN, or a file:"""
    token_file: Path | None = None
    """File that holds the token, readable by its owner only (chmod 600)."""
    read_token: str | None = Field(None, min_length=SHORTEST_TOKEN, repr=False)
    """Whoever knows it may look and ask, and steer nothing. Or $CHACHART_READ_TOKEN, or a file:"""
    read_token_file: Path | None = None
    """File that holds the reading token, readable by its owner only (chmod 600)."""
    trust_local: bool = False
    """People on this machine need neither token nor key; never what a proxy passed on."""
    keys: Path | None = None
    """Folder of CURVE keys (`chachart keys`); once set, ZeroMQ sockets take only peers whose key is there."""
    without_keys: tuple[str, ...] = Field((), examples=[("tcp://0.0.0.0:5556",)])
    """Endpoints that other machines reach and that take anybody all the same; each start warns of them."""
    tls_cert: Path | None = None
    """Certificate chain (PEM) with which `view` and `metrics` serve HTTPS."""
    tls_key: Path | None = None
    """Its private key (PEM)."""
    max_connections: int = Field(256, ge=1, le=65536)
    """So many connections each listening socket takes; more are turned away."""
    max_subscriptions: int = Field(64, ge=1, le=65536)
    """So many subscriptions each subscriber may have; one with more is disconnected."""
    max_requests_per_s: float = Field(200.0, gt=0)
    """So many requests a second each address may make in the long run, five times that at once."""


class Role(IntEnum):
    """What somebody may do."""

    NOBODY = 0
    READER = 1
    STEERER = 2


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a node, or of one of its sinks. Comparisons take the same time however much is right."""

    steer: str | None = field(default=None, repr=False)
    read: str | None = field(default=None, repr=False)

    @classmethod
    def of(cls, settings: SecuritySettings, own: str | None = None, *, from_environment: bool = True) -> Self:
        """The tokens that `settings` name; `own` is a sink's own steering token, which goes before.

        Raises
        ------
        SetupError
            If a file cannot be read, others may read it, or a token is too short or given twice.
        """
        environment = os.environ if from_environment else {}
        steer = own or _token(
            "token", settings.token, settings.token_file, TOKEN_VARIABLE, environment.get(TOKEN_VARIABLE)
        )
        read = _token(
            "read_token",
            settings.read_token,
            settings.read_token_file,
            READ_TOKEN_VARIABLE,
            environment.get(READ_TOKEN_VARIABLE),
        )
        if steer is not None and steer == read:
            raise SetupError("[security]: the reading token must not be the steering token")
        return cls(steer, read)

    def __bool__(self) -> bool:
        return self.steer is not None or self.read is not None

    def role(self, given: object) -> Role:
        """What somebody who gives this token may do."""
        return self._role(given, lambda token: token)

    def cookie(self, role: Role) -> str:
        """What a browser keeps instead of the token; it says nothing about it."""
        token = self.steer if role == Role.STEERER else self.read
        return _cookie(token or "")

    def cookie_role(self, given: object) -> Role:
        """What somebody with this cookie may do."""
        return self._role(given, _cookie)

    def _role(self, given: object, form: Callable[[str], str]) -> Role:
        if not isinstance(given, str) or len(given) > _ASKS_TOO_MUCH:
            return Role.NOBODY
        found = Role.NOBODY
        for role, token in ((Role.READER, self.read), (Role.STEERER, self.steer)):
            if token is not None and hmac.compare_digest(_digest(given), _digest(form(token))):
                found = role
        return found


def security_problems(settings: SecuritySettings) -> Iterator[str]:
    """What would keep a node from being as safe as `settings` want it."""
    try:
        Tokens.of(settings)
    except SetupError as error:
        yield str(error)
    if (settings.tls_cert is None) != (settings.tls_key is None):
        yield "[security]: tls_cert and tls_key go together"
    if settings.keys is not None and not settings.keys.is_dir():
        yield f"[security]: keys = {settings.keys} is no folder; `chachart keys new node` makes one"


def endpoint_exposure(who: str, endpoint: str, security: SecuritySettings) -> list[str]:
    """Why `who` must not listen on a ZeroMQ endpoint, as a mistake of the configuration."""
    if is_local(endpoint) or security.keys is not None or endpoint in security.without_keys:
        return []
    return [
        f"{who} listens on {endpoint}, which others can reach: set keys in [security] (`chachart keys new "
        "node` makes them), or name the endpoint in without_keys there to take anybody"
    ]


def _token(
    name: str, value: str | None, path: Path | None, variable: str, from_environment: str | None
) -> str | None:
    given = [text for text in (value, path, from_environment) if text is not None]
    if len(given) > 1:
        raise SetupError(f"[security]: {name} is given twice: set one of {name}, {name}_file and ${variable}")
    token = value or from_environment
    if path is not None:
        token = _read_secret(path)
    if token is not None and not (SHORTEST_TOKEN <= len(token) <= _ASKS_TOO_MUCH and token.isprintable()):
        where = str(path) if path is not None else f"${variable}"
        raise SetupError(f"[security]: {where} must hold a token of {SHORTEST_TOKEN} characters or more")
    return token


def _read_secret(path: Path) -> str:
    try:
        with path.open(encoding="utf-8") as file:
            mode = os.fstat(file.fileno()).st_mode
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise SetupError(f"{path} holds a secret that others may read: chmod 600 {path}")
            return file.read(2 * _ASKS_TOO_MUCH).strip()
    except OSError as error:
        raise SetupError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SetupError(f"{path} must hold a token as UTF-8 text") from None


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode(errors="replace")).digest()


def _cookie(token: str) -> str:
    return hmac.new(token.encode(), b"chachart cookie", hashlib.sha256).hexdigest()
