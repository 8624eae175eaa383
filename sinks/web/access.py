"""Who may ask: people on this machine, and whoever knows the token.

A request counts as local when it comes from a loopback address, names a loopback host and was not passed on
by a proxy. The second condition is what keeps a web page from reaching a node by a host name that it has
turned into 127.0.0.1 (DNS rebinding). Everything else needs the token: as `Authorization: Bearer ...`, as
`?token=...`, or as the cookie that a browser gets for the latter. Another site's pages are turned
away always.
"""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

COOKIE = "chachart_token"
_PASSED_ON = ("Forwarded", "X-Forwarded-For", "X-Real-IP", "Via")


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's own, for sure.

    >>> is_loopback("127.0.0.2"), is_loopback("::1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    if host.lower() == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host.strip("[]").split("%")[0])
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return bool((mapped or address).is_loopback)


def same_token(given: object, token: str | None) -> bool:
    """Whether what was given is the token, in a time that does not tell how much of it was right."""
    if token is None or not isinstance(given, str):
        return False
    return hmac.compare_digest(given.encode(errors="replace"), token.encode())


class Access:
    """Decides about requests.

    Parameters
    ----------
    token
        What everybody but local people must know; None lets nobody else in.
    """

    def __init__(self, token: str | None) -> None:
        self._token = token

    def refusal(self, peer: str, headers: Mapping[str, str], given: str | None) -> tuple[int, str] | None:
        """HTTP status and reason to turn a request away, or None to let it in.

        Parameters
        ----------
        peer
            The address that the request came from.
        headers
            Its headers, names in any case.
        given
            The token in its query, if any.
        """
        host = headers.get("Host", "")
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return 403, "pages of another site may not ask this node"
        if self._is_local(peer, host, headers) or self.knows(given):
            return None
        if self.knows(_bearer(headers)) or self.knows(_cookie(headers)):
            return None
        if self._token is None:
            return 403, "only this machine may ask: open the node by a loopback address, or give it a token"
        return 401, "a token is needed"

    def knows(self, given: str | None) -> bool:
        """Whether that is the token."""
        return same_token(given, self._token)

    @staticmethod
    def _is_local(peer: str, host: str, headers: Mapping[str, str]) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        passed_on = any(header in headers for header in _PASSED_ON)
        return is_loopback(peer) and is_loopback(name) and not passed_on


def _bearer(headers: Mapping[str, str]) -> str | None:
    scheme, _, value = headers.get("Authorization", "").partition(" ")
    return value.strip() if scheme.lower() == "bearer" else None


def _cookie(headers: Mapping[str, str]) -> str | None:
    try:
        morsel = SimpleCookie(headers.get("Cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return None if morsel is None else morsel.value
