"""Charts live in Foxglove: its WebSocket, served by its own SDK."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import missing, require
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.endpoints import is_local
from chachart.node.net.security import SecuritySettings
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.gathering import Gathering
from chachart.sinks.plain import plain
from chachart.sinks.point_cloud import SCHEMA, point_cloud
from chachart.sinks.schemas import schemas

if TYPE_CHECKING:
    import foxglove
    from foxglove.websocket import WebSocketServer


class FoxgloveSettings(SinkSettings):
    """`type = "foxglove"`: charts, quality and status to Foxglove, live. Loopback only: no tokens."""

    type: Literal["foxglove"] = "foxglove"
    host: str = Field("127.0.0.1", min_length=1)
    """Address to listen on: one of this machine's own. Others come by `ssh -L`."""
    port: int = Field(8765, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    every_s: float = Field(0.1, ge=0)
    """Charts are gathered for so long, a UE is sent once with its newest place; 0 sends every update."""
    queue_messages: int = Field(1024, ge=16, le=65536)
    """Messages that may wait for each viewer; a slower one loses the oldest."""

    def listens_on(self) -> str | None:
        """Its address, unless any free port will do."""
        return f"tcp://{self.host}:{self.port}" if self.port else None

    def exposure(self, security: SecuritySettings) -> list[str]:
        """An address that other machines reach would let anybody in."""
        if is_local(f"tcp://{self.host}:{self.port}"):
            return []
        return [
            f'sink "foxglove" listens on {self.host}, which others can reach, and knows no tokens: use ssh -L'
        ]


class Foxglove(Sink):
    """Channels `/chart/<array>/points`, `chart.<array>`, `quality.<array>`, `status.<array>`."""

    Settings: ClassVar[type[SinkSettings]] = FoxgloveSettings
    settings: FoxgloveSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._gathering = Gathering(self.settings.every_s)
        self._context: foxglove.Context | None = None
        self._server: WebSocketServer | None = None
        self._channels: dict[str, foxglove.Channel] = {}
        self._where: str | None = None

    @classmethod
    def problems(cls, settings: FoxgloveSettings) -> list[str]:
        """Whether its library is there."""
        return missing("foxglove")

    def open(self, node: NodeAccess | None) -> None:
        """Listen.

        Raises
        ------
        SetupError
            If its library is missing, or the port is in use.
        """
        require("foxglove", 'sink "foxglove":')
        import foxglove

        s = self.settings
        context = self._context = foxglove.Context()  # without it the server tells of no channel
        try:
            self._server = foxglove.start_server(
                name=f"chachart {self.array.name}",
                host=s.host,
                port=s.port,
                context=context,
                message_backlog_size=s.queue_messages,
            )
        except (OSError, RuntimeError) as error:
            raise SetupError(f'sink "foxglove" cannot listen on {s.host}:{s.port}: {error}') from None
        self._where = f"ws://{s.host}:{self._server.port}"
        kinds = {kind: (f"{kind}.{self.array.name}", schema) for kind, schema in schemas().items()}
        kinds["points"] = f"/chart/{self.array.name}/points", SCHEMA
        self._channels = {
            kind: foxglove.Channel(topic, schema=schema, message_encoding="json", context=context)
            for kind, (topic, schema) in kinds.items()
        }

    def on_chart(self, update: ChartUpdate) -> None:
        """Gather the update; send what is gathered when it is time."""
        self._gathering.add(update)
        self.on_tick()

    def on_quality(self, report: dict[str, Any]) -> None:
        """Send the report."""
        self._send("quality", {"array": self.array.name, **plain(report)})

    def on_status(self, report: dict[str, Any]) -> None:
        """Send the report."""
        self._send("status", {"array": self.array.name, **plain(report)})

    def on_tick(self) -> None:
        """Send what is gathered when it is time."""
        update = self._gathering.due()
        if update is not None:
            self._chart(update)

    def close(self) -> None:
        """Send what is gathered, and stop listening."""
        update = self._gathering.take()
        if self._server is not None:
            if update is not None:
                self._chart(update)
            self._server.stop()
            for channel in self._channels.values():
                channel.close()
            self._server = self._context = None
            self._channels = {}

    def where(self) -> str | None:
        """Its address, to open in Foxglove."""
        return self._where

    def _chart(self, update: ChartUpdate) -> None:
        if self._channels["points"].has_sinks():
            self._send("points", point_cloud(update))
        if self._channels["chart"].has_sinks():
            self._send("chart", update.plain())
        self._gathering.done()

    def _send(self, kind: str, values: dict[str, Any]) -> None:
        self._channels[kind].log(values)
