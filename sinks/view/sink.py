"""The live view: serves the page, and everything the page shows, on one port.

GET  /                              the page
GET  /ws                            the WebSocket behind it, see `chachart.sinks.view.reception`
GET  /api/status /api/ues /api/chart /api/recordings /api/spectrum?ue=
GET  /recordings?name=              a recording of the folder, to keep
POST /api/replay?paused=&speed=&at_s=
POST /api/method?theta=&rho=        see `chachart.sinks.operations`
POST /api/record?on=&path=
GET  /healthz /readyz /metrics
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.security import Role
from chachart.sinks.base import NodeAccess, SinkSettings
from chachart.sinks.operations import CHANGING, READING, Operations
from chachart.sinks.plain import encoded
from chachart.sinks.view.curve import CurveKeeper
from chachart.sinks.view.history import History
from chachart.sinks.view.hub import Hub, report
from chachart.sinks.view.names import load_names
from chachart.sinks.view.plan import FloorPlan
from chachart.sinks.view.reception import Reception
from chachart.sinks.web.answers import JSON, Answer, Query, Route
from chachart.sinks.web.server import WebServer
from chachart.sinks.web.settings import WebSettings
from chachart.sinks.web.sink import WebSink

PAGE = Path(__file__).parent / "page"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_NOT_SHOWN = ("quality", "latency_histogram")


class ViewSettings(WebSettings):
    """`type = "view"`: the live view in a browser, with HTTP control, health and metrics."""

    type: Literal["view"] = "view"
    rate_hz: float = Field(10.0, gt=0, le=30)
    """Chart frames a second to each viewer."""
    max_viewers: int = Field(64, ge=1, le=1024)
    """So many may look at the same time."""
    record_folder: Path = Field(Path("."), validate_default=False)
    """Where recordings that viewers start go; they choose the file's name and nothing else."""
    history_bytes: int = Field(64 * 1024**2, ge=0)
    """The last minutes of the chart are kept within so many bytes, for viewers to look back; 0 keeps none."""
    names: Path | None = Field(None, validate_default=False)
    """A CSV file with names of UEs: number or MAC address, then the name."""
    plan_folder: Path = Field(Path("."), validate_default=False)
    """Where a floor plan that a viewer puts under the chart is kept: `plan.image` and `plan.json`."""
    heading_deg: float | None = Field(None, ge=-360, le=360)
    """Which way the chart's x axis looks, clockwise from north, for a compass; not set: none is drawn."""


class View(WebSink):
    """Shows the chart to people and takes their wishes."""

    Settings: ClassVar[type[SinkSettings]] = ViewSettings
    settings: ViewSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._hub: Hub | None = None
        self._history = History(self.settings.history_bytes)
        self._pages = {file.name: file.read_bytes() for file in sorted(PAGE.iterdir())}

    @classmethod
    def problems(cls, settings: Any) -> list[str]:
        """Whether the port is free and the names can be read."""
        try:
            load_names(settings.names) if settings.names else None
        except SetupError as error:
            return [*super().problems(settings), str(error)]
        return super().problems(settings)

    def _serve(self, node: NodeAccess, routes: Mapping[str, Route]) -> WebServer:
        names = load_names(self.settings.names) if self.settings.names else {}
        self._hub = Hub((self.array, *self.others), node, self.settings.rate_hz, self._history)
        operations = Operations(node, self.settings.record_folder)
        plan = FloorPlan(self.settings.plan_folder)
        page_id = hashlib.sha256(b"".join(self._pages.values())).hexdigest()[:16]
        curve = CurveKeeper(node, self.array)
        told = {
            "names": {str(ue): name for ue, name in names.items()},
            "heading_deg": self.settings.heading_deg,
        }
        reception = Reception(self._hub, operations, curve, self.settings.max_viewers, page_id, plan, told)
        kept: dict[str, Route] = {
            "GET /recordings": partial(_download, operations),
            "GET /plan": lambda _: Answer(*plan.image()),
        }
        return WebServer(
            self.settings,
            {**self._page_routes(), **_control_routes(operations), **kept, **routes},
            reception.welcome,
            self._hub.run,
            self._pages["sign-in.html"],
            self.security,
        )

    def on_chart(self, update: ChartUpdate) -> None:
        """Pass estimates on to viewers, if there are any, and keep them for a while."""
        self._history.take(update)
        if self._hub is not None:
            self._hub.offer(update)

    def on_quality(self, values: dict[str, Any]) -> None:
        """Show how good the chart is."""
        self._tell("quality", values)

    def on_status(self, values: dict[str, Any]) -> None:
        """Show how the node is."""
        super().on_status(values)
        self._tell("status", {key: value for key, value in values.items() if key not in _NOT_SHOWN})

    def _tell(self, kind: str, values: dict[str, Any]) -> None:
        if self._server is not None and self._hub is not None:
            self._server.soon(self._hub.tell, kind, report(values, time.time_ns()))

    def _page_routes(self) -> dict[str, Route]:
        def page(body: bytes, suffix: str) -> Route:
            return lambda _: Answer(body, _TYPES[suffix])

        routes = {f"GET /{name}": page(body, Path(name).suffix) for name, body in self._pages.items()}
        return {"GET /": routes["GET /index.html"], **routes}


def _download(operations: Operations, query: Query) -> Answer:
    name = query.get("name", "")
    body = operations.recordings.content(name)
    keep = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Answer(body, "application/octet-stream", headers=keep)


def _control_routes(operations: Operations) -> dict[str, Route]:
    def control(op: str) -> Route:
        def answer(query: Query) -> Answer:
            return Answer(operations.reply({**query, "op": op}, Role.STEERER, encoded), JSON)

        return answer

    reading = {f"GET /api/{op}": control(op) for op in READING}
    return {**reading, **{f"POST /api/{op}": control(op) for op in CHANGING}}
