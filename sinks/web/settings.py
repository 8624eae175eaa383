"""What every sink that serves HTTP is told, and whether it can be had."""

from __future__ import annotations

import os
import socket as socketlib
import ssl
from contextlib import suppress
from pathlib import Path

from pydantic import Field

from chachart.node.data.errors import SetupError
from chachart.node.net.endpoints import fixed, is_loopback
from chachart.node.net.security import SecuritySettings, Tokens
from chachart.sinks.base import SinkSettings


class WebSettings(SinkSettings):
    """What every sink that serves HTTP is told."""

    host: str = Field("127.0.0.1", min_length=1)
    """Address to listen on; anything but loopback needs a token, see [security]."""
    port: int = Field(8080, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    spare_ports: int = Field(0, ge=0, le=1000)
    """Where the port is in use, one of so many after it serves instead; the log says which."""
    token: str | None = Field(None, min_length=16, repr=False)
    """What people must know to ask and steer, 16 characters or more; not set: as [security] says."""
    stale_after_s: float = Field(5.0, gt=0)
    """Without a new frame for so long, /readyz says no."""

    tls_cert: Path | None = None
    """Certificate chain (PEM) for HTTPS; not set: as [security] says."""
    tls_key: Path | None = None
    """Its private key (PEM)."""

    def listens_on(self) -> str | None:
        """Host and port, unless any free port will do."""
        return fixed(f"tcp://{self.host}:{self.port}")

    def exposure(self, security: SecuritySettings) -> list[str]:
        """A server that other machines reach needs a token, and a certificate that can be read."""
        found = []
        with suppress(SetupError):  # a token that cannot be read is told once, for [security]
            if not is_loopback(self.host) and not Tokens.of(security, self.token):
                found.append(
                    f'sink "{self.type}": a token must be set, here or in [security], to listen on '
                    f"{self.host}, which others can reach"
                )
        try:
            self.tls(security)
        except SetupError as error:
            found.append(str(error))
        return found

    def tls(self, security: SecuritySettings) -> ssl.SSLContext | None:
        """What HTTPS needs; None serves plain HTTP.

        Raises
        ------
        SetupError
            If certificate or key cannot be read or do not belong together.
        """
        cert, key = self.tls_cert or security.tls_cert, self.tls_key or security.tls_key
        if cert is None or key is None:
            if cert is not key:
                raise SetupError(f'sink "{self.type}": tls_cert and tls_key go together')
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(cert, key, password=_no_password)
        except (OSError, ValueError) as error:  # SSLError is an OSError
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            raise SetupError(f"cannot serve HTTPS with {cert} and {key}: {reason}") from None
        return context


def port_problems(settings: WebSettings) -> list[str]:
    """What would keep a server from listening where `settings` say."""
    problems: list[str] = []
    for port in ports(settings):
        try:
            family, kind, proto, _, address = socketlib.getaddrinfo(
                settings.host, port, type=socketlib.SOCK_STREAM, flags=socketlib.AI_PASSIVE
            )[0]
            with socketlib.socket(family, kind, proto) as probe:
                probe.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_REUSEADDR, 1)
                probe.bind(address)
        except UnicodeError:
            return [f'sink "{settings.type}" cannot listen on {settings.host!r}: that is no name of a host']
        except OSError as error:
            problems = problems or [cannot_listen(settings, error)]
        else:
            return []
    return problems


def ports(settings: WebSettings) -> range:
    """The port and its spare ones, in the order in which they are tried."""
    return range(settings.port, min(settings.port + settings.spare_ports, 65535) + 1)


def cannot_listen(settings: WebSettings, error: OSError) -> str:
    reason = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
    return f'sink "{settings.type}" cannot listen on {settings.host}:{settings.port}: {reason}'


def _no_password() -> str:
    raise ValueError("the key is locked with a password")
