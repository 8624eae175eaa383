"""What routes answer, and the headers that go with every answer."""

from __future__ import annotations

import http
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from websockets.datastructures import Headers
from websockets.http11 import Response

JSON = "application/json"
HTML = "text/html; charset=utf-8"
_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
SECURITY = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}

Query = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a route gives back."""

    body: bytes
    content_type: str
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def text(cls, status: int, text: str) -> Answer:
        """One line of plain text."""
        return cls(f"{text}\n".encode(), "text/plain; charset=utf-8", status)

    def with_headers(self, **headers: str) -> Answer:
        """The same with more headers; `_` stands for `-`."""
        more = {name.replace("_", "-"): value for name, value in headers.items()}
        return replace(self, headers={**self.headers, **more})

    def response(self, *, head: bool = False) -> Response:
        """What goes over the wire; without the body where only the headers were asked for."""
        headers = Headers(
            {
                "Connection": "close",
                "Content-Length": str(len(self.body)),
                "Content-Type": self.content_type,
                **SECURITY,
                **self.headers,
            }
        )
        phrase = http.HTTPStatus(self.status).phrase
        return Response(self.status, phrase, headers, b"" if head else self.body)


Route = Callable[[Query], Answer]
"""Answers one request, in a thread of the server's."""
