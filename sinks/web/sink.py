"""What sinks that serve HTTP share: a server, health and metrics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.web.answers import Route
from chachart.sinks.web.exposition import metrics_routes
from chachart.sinks.web.health import Health, health_routes
from chachart.sinks.web.server import WebServer
from chachart.sinks.web.settings import WebSettings, port_problems


class WebSink(Sink):
    """Serves `/metrics`, `/healthz` and `/readyz`; subclasses add routes of their own in `_serve`."""

    Settings: ClassVar[type[SinkSettings]] = WebSettings
    settings: WebSettings
    page: ClassVar[str] = "/"
    """Where people look first."""

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._health = Health(self.settings.stale_after_s)
        self._server: WebServer | None = None

    @classmethod
    def problems(cls, settings: WebSettings) -> list[str]:
        """Whether the port is free."""
        return port_problems(settings)

    def open(self, node: NodeAccess | None) -> None:
        """Serve from now on.

        Raises
        ------
        SetupError
            If the port cannot be had.
        """
        if node is None:
            raise ValueError(f"{self.settings.type} needs its node")
        self._server = self._serve(node, {**health_routes(self._health), **metrics_routes(node)})
        self.refused = self._server.refusals
        self._server.start()

    def _serve(self, node: NodeAccess, routes: Mapping[str, Route]) -> WebServer:
        """The server, with the routes that every web sink has."""
        return WebServer(self.settings, routes, security=self.security)

    def on_status(self, report: dict[str, Any]) -> None:
        """Keep an eye on the node."""
        self._health.status(report)

    def on_tick(self) -> None:
        """The node calls: it lives."""
        self._health.called()

    def close(self) -> None:
        """Stop serving."""
        if self._server is not None:
            self._server.stop()
            self._server = None

    def where(self) -> str | None:
        """The address of the page."""
        return None if self._server is None else f"{self._server.address}{self.page}"
