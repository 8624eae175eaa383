"""Charts to an MQTT broker, which homes, buildings and robots listen to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import missing, require
from chachart.node.data.geometry import ArrayGeometry
from chachart.sinks.base import NodeAccess, Sink, SinkSettings
from chachart.sinks.gathering import Gathering
from chachart.sinks.plain import encoded

if TYPE_CHECKING:
    from paho.mqtt.client import Client

KEEP_ALIVE_S = 30
CLOSE_S = 2.0
ROWS_PER_MESSAGE = 256


class MqttSettings(SinkSettings):
    """`type = "mqtt"`: charts, quality and status to an MQTT broker, as JSON."""

    type: Literal["mqtt"] = "mqtt"
    host: str = Field("127.0.0.1", min_length=1)
    """Where the broker is."""
    port: int = Field(1883, ge=1, le=65535)
    """Its port; with TLS usually 8883."""
    prefix: str = Field("chachart", pattern=r"^[^#+\x00]+$", max_length=128)
    """Topics begin with it: `<prefix>/<array>/chart` and so on."""
    each_ue: bool = False
    """true sends each row on a topic of its own, `<prefix>/<array>/ue/<UE>`, beside the gathered charts."""
    every_s: float = Field(1.0, ge=0)
    """Charts are gathered for so long, a UE is sent once with its newest place; 0 sends every update."""
    username: str | None = None
    """Who the broker takes the node for."""
    password: str | None = Field(None, repr=False)
    """Its password."""
    tls: bool = False
    """true speaks TLS, with the certificates that this machine trusts."""
    queue_messages: int = Field(1024, ge=16, le=65536)
    """Messages that may wait while the broker is away; more are lost and counted."""


class Mqtt(Sink):
    """Topics `<prefix>/<array>/...`: `chart` ({method, columns}), `ue/<UE>` (a row), `quality` and `status`
    (retained), and `online` (retained: `true`, and `false` once the node has gone, however it went).
    """

    Settings: ClassVar[type[SinkSettings]] = MqttSettings
    settings: MqttSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._gathering = Gathering(self.settings.every_s)
        self._client: Client | None = None

    @classmethod
    def problems(cls, settings: MqttSettings) -> list[str]:
        """Whether its library is there."""
        return missing("mqtt")

    def open(self, node: NodeAccess | None) -> None:
        """Begin to connect; a broker that is away is tried again until it is there.

        Raises
        ------
        SetupError
            If its library is missing.
        """
        require("mqtt", 'sink "mqtt":')
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        s = self.settings
        client = self._client = Client(CallbackAPIVersion.VERSION2)
        client.max_queued_messages_set(s.queue_messages)
        client.reconnect_delay_set(1, 30)
        client.will_set(self._topic("online"), "false", qos=1, retain=True)
        if s.username is not None:
            client.username_pw_set(s.username, s.password)
        if s.tls:
            client.tls_set()
        client.on_connect = self._connected
        client.on_connect_fail = lambda *_: self._away("does not answer")
        client.on_disconnect = lambda *_: self._away("has gone")
        try:
            client.connect_async(s.host, s.port, KEEP_ALIVE_S)
        except ValueError as error:
            raise SetupError(f'sink "mqtt": {s.host}:{s.port}: {error}') from None
        client.loop_start()

    def on_chart(self, update: ChartUpdate) -> None:
        """Gather the update; send what is gathered when it is time."""
        self._gathering.add(update)
        self.on_tick()

    def on_quality(self, report: dict[str, Any]) -> None:
        """Send the report, to stay with the broker."""
        self._send("quality", report, retain=True)

    def on_status(self, report: dict[str, Any]) -> None:
        """Send the report, to stay with the broker."""
        self._send("status", report, retain=True)

    def on_alert(self, event: dict[str, Any]) -> None:
        """Send it."""
        self._send("alert", event)

    def on_tick(self) -> None:
        """Send what is gathered when it is time."""
        update = self._gathering.due()
        if update is not None:
            self._chart(update)

    def close(self) -> None:
        """Send what is gathered, say that the node has gone, and hang up."""
        if self._client is None:
            return
        update = self._gathering.take()
        if update is not None:
            self._chart(update)
        if self._client.is_connected():
            last = self._client.publish(self._topic("online"), "false", qos=1, retain=True)
            last.wait_for_publish(CLOSE_S)
        self._client.disconnect()
        self._client.loop_stop()
        self._client = None

    def where(self) -> str | None:
        """The broker, and what topics begin with."""
        return f"mqtt://{self.settings.host}:{self.settings.port}/{self.settings.prefix}/{self.array.name}"

    def _topic(self, kind: str) -> str:
        return f"{self.settings.prefix}/{self.array.name}/{kind}"

    def _chart(self, update: ChartUpdate) -> None:
        for part in update.parts(ROWS_PER_MESSAGE):
            values = part.plain()
            self._send("chart", values, rows=len(part))
            if self.settings.each_ue:
                columns = {k: v for k, v in values.items() if isinstance(v, list)}
                for i, ue in enumerate(columns["ue"]):
                    self._send(f"ue/{ue}", {name: column[i] for name, column in columns.items()})
        self._gathering.done()

    def _send(self, kind: str, values: dict[str, Any], *, retain: bool = False, rows: int = 0) -> None:
        from paho.mqtt.enums import MQTTErrorCode

        assert self._client is not None
        sent = self._client.publish(self._topic(kind), encoded(values), qos=1, retain=retain)
        if sent.rc == MQTTErrorCode.MQTT_ERR_QUEUE_SIZE:
            self.lost.add("queue_full", max(rows, 1))

    def _connected(
        self, client: Client, userdata: object, flags: object, code: Any, properties: object
    ) -> None:
        if code.is_failure:
            self._away(f"refuses: {code}")
            return
        self.trouble = None
        client.publish(self._topic("online"), "true", qos=1, retain=True)

    def _away(self, why: str) -> None:
        if self._client is not None:
            self.trouble = f"the broker {self.settings.host}:{self.settings.port} {why}"
