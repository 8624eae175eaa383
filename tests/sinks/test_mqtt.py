"""The sink `mqtt`, with Debian's mosquitto as the broker and a listener of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chart_samples import QUALITY, STATUS, StillNode, some_chart
from csi_samples import small_array
from live_node import free_port, tool, until
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from sink_contract import SinkCase, SinkContract

from chachart.sinks.mqtt import Mqtt, MqttSettings


class Broker:
    """mosquitto on a port of its own."""

    def __init__(self, folder: Path) -> None:
        program = (
            "/usr/sbin/mosquitto" if Path("/usr/sbin/mosquitto").exists() else tool("mosquitto", "mosquitto")
        )
        self._program, self.port = shutil.which(program) or program, free_port()
        self._config = folder / "mosquitto.conf"
        self._config.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        self.start()

    def start(self) -> None:
        command = [self._program, "-c", str(self._config)]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()


class Listener:
    """Somebody who listens to everything."""

    def __init__(self, port: int) -> None:
        self.heard: dict[str, list[Any]] = {}
        self.retained: set[str] = set()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.on_message = self._take
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", port)
        self._client.loop_start()
        until(self._client.is_connected, "the broker answers")

    def _take(self, client: Client, data: object, message: Any) -> None:
        self.heard.setdefault(message.topic, []).append(json.loads(message.payload))
        if message.retain:
            self.retained.add(message.topic)

    def stop(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        del self._client  # paho closes its last sockets when it is collected


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    broker = Broker(tmp_path)
    yield broker
    broker.stop()


@pytest.fixture
def listener(broker: Broker) -> Iterator[Listener]:
    listener = Listener(broker.port)
    yield listener
    listener.stop()


class TestContract(SinkContract):
    @pytest.fixture
    def case(self, broker: Broker) -> SinkCase:
        return SinkCase("mqtt", {"port": broker.port}, small_array())


def test_charts_rows_and_reports_arrive(broker: Broker, listener: Listener) -> None:
    sink = Mqtt(MqttSettings(port=broker.port, every_s=0.0, each_ue=True), small_array())
    sink.open(StillNode())
    chart = some_chart(5, first_ue=3)
    try:
        sink.on_chart(chart)
        sink.on_quality(QUALITY)
        sink.on_status(STATUS)
        until(lambda: "chachart/lab/status" in listener.heard, "the status arrives")
        until(lambda: "chachart/lab/ue/7" in listener.heard, "the last row arrives")
    finally:
        sink.close()
    [values] = listener.heard["chachart/lab/chart"]
    assert values["ue"] == [3, 4, 5, 6, 7]
    assert values["method"] == {"theta": "bartlett", "rho": "isq"}
    [row] = listener.heard["chachart/lab/ue/4"]
    assert row["x"] == pytest.approx(chart.x[1], abs=1e-3)
    assert listener.heard["chachart/lab/quality"][0]["tw"] == QUALITY["tw"]
    until(lambda: listener.heard["chachart/lab/online"] == [True, False], "it says that it comes and goes")
    late = Listener(broker.port)
    try:
        kept = {"chachart/lab/status", "chachart/lab/quality", "chachart/lab/online"}
        until(lambda: late.retained >= kept, "whoever comes later is told")
    finally:
        late.stop()


def test_a_broker_that_is_away_is_told_and_found_again(broker: Broker) -> None:
    broker.stop()
    sink = Mqtt(MqttSettings(port=broker.port, every_s=0.0), small_array())
    sink.open(StillNode())
    try:
        until(lambda: sink.trouble, "it says that the broker does not answer")
        sink.on_chart(some_chart(5))
        broker.start()
        until(lambda: sink.trouble is None, "it is found again")
        assert sink.lost.as_dict() == {}
    finally:
        sink.close()


def test_what_does_not_fit_the_queue_is_counted(broker: Broker) -> None:
    broker.stop()
    sink = Mqtt(MqttSettings(port=broker.port, every_s=0.0, queue_messages=16), small_array())
    sink.open(StillNode())
    try:
        for _ in range(20):
            sink.on_chart(some_chart(5))
        assert sink.lost.as_dict() == {"queue_full": 4 * 5}
    finally:
        sink.close()
