"""Who may ask over HTTP, and what.

Where no token is set, people on this machine may, and nobody else. A request counts as local when it comes
from a loopback address, names a loopback host and was not passed on by a proxy. The second condition is what
keeps a web page from reaching a node by a host name that it has turned into 127.0.0.1 (DNS rebinding).

Once a token is set everybody needs one, unless local people are trusted: as `Authorization: Bearer ...`, as
`?token=...`, or as the cookie that a browser gets when it signs in. Pages of another site are turned away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from chachart.node.net.endpoints import is_loopback
from chachart.node.net.limits import GUESSES_AT_ONCE, GUESSES_PER_S, RateLimit
from chachart.node.net.security import Role, Tokens

COOKIE = "chachart_token"
_PASSED_ON = ("Forwarded", "Via", "X-Real-IP", "X-Client-IP", "True-Client-IP", "CF-Connecting-IP")


@dataclass(frozen=True, slots=True)
class Refusal:
    """HTTP status, reason for people, and the word it is counted by."""

    status: int
    reason: str
    word: str


class Access:
    """Decides about requests.

    Parameters
    ----------
    tokens
        What people must know.
    trust_local
        Whether people on this machine need no token.
    """

    def __init__(self, tokens: Tokens, trust_local: bool = False) -> None:
        self.tokens = tokens
        self._trust_local = trust_local or not tokens
        self._guesses = RateLimit(GUESSES_PER_S, GUESSES_AT_ONCE)

    def admit(
        self, peer: str, headers: Mapping[str, str], given: str | None, cookie: str = COOKIE
    ) -> Role | Refusal:
        """What the one who asks may do, or why nothing.

        Parameters
        ----------
        peer
            The address that the request came from.
        headers
            Its headers, names in any case.
        given
            The token in its query, if any.
        cookie
            Name of the cookie that a browser got.
        """
        host = headers.get("Host", "")
        origin = headers.get("Origin")
        if origin is not None and _site(origin) != host.lower():
            return Refusal(403, "pages of another site may not ask this node", "foreign_page")
        role = self.tokens.cookie_role(_cookie(headers, cookie))
        token = given if given is not None else _bearer(headers)
        if token is not None and self.tokens and role < Role.STEERER:
            signed_in = self.sign_in(peer, token)
            if role == Role.NOBODY or isinstance(signed_in, Role):
                return signed_in
        if role:
            return role
        if self._trust_local and _is_local(peer, host, headers):
            return Role.STEERER
        if not self.tokens:
            reason = "only this machine may ask: open the node by a loopback address, or give it a token"
            return Refusal(403, reason, "not_local")
        return Refusal(401, "a token is needed", "no_token")

    def sign_in(self, peer: str, token: str) -> Role | Refusal:
        """What somebody with this token may do; after some wrong ones an address has to wait."""
        if not self._guesses.wait_s(peer):
            if role := self.tokens.role(token):
                return role
            self._guesses.take(peer)
            return Refusal(401, "that is not the token", "wrong_token")
        return Refusal(429, "too many wrong tokens: wait a few seconds", "too_many_guesses")


def _site(origin: str) -> str | None:
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return None


def _is_local(peer: str, host: str, headers: Mapping[str, str]) -> bool:
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    passed_on = any(header in headers for header in _PASSED_ON)
    passed_on |= any(header.lower().startswith("x-forwarded") for header in headers)
    return is_loopback(peer) and is_loopback(name) and not passed_on


def _bearer(headers: Mapping[str, str]) -> str | None:
    scheme, _, value = headers.get("Authorization", "").partition(" ")
    return value.strip() if scheme.lower() == "bearer" else None


def _cookie(headers: Mapping[str, str], name: str) -> str | None:
    try:
        morsel = SimpleCookie(headers.get("Cookie", "")).get(name)
    except CookieError:
        return None
    return None if morsel is None else morsel.value
