"""The sink `foxglove`, seen by a WebSocket client that speaks Foxglove's protocol."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any

import numpy as np
import pytest
from chart_samples import QUALITY, StillNode, some_chart
from csi_samples import small_array
from live_node import free_port
from sink_contract import SinkCase, SinkContract
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from chachart.node.data.errors import SetupError
from chachart.sinks.foxglove import Foxglove, FoxgloveSettings
from chachart.sinks.point_cloud import POINT


@pytest.fixture(scope="module", autouse=True)
def _runtime() -> None:
    """The SDK's runtime keeps a pair of sockets for good once it has begun."""
    sink = Foxglove(FoxgloveSettings(port=0), small_array())
    sink.open(StillNode())
    sink.close()


class TestContract(SinkContract):
    @pytest.fixture
    def case(self) -> SinkCase:
        return SinkCase("foxglove", {"port": 0}, small_array())

    def test_an_address_that_others_reach_is_a_mistake(self) -> None:
        settings = FoxgloveSettings(host="192.0.2.7")
        assert "others can reach" in settings.exposure(Foxglove.security)[0]
        assert FoxgloveSettings().exposure(Foxglove.security) == []


def test_a_port_in_use_is_told() -> None:
    settings = FoxgloveSettings(port=free_port())
    first, second = Foxglove(settings, small_array()), Foxglove(settings, small_array())
    first.open(StillNode())
    try:
        with pytest.raises(SetupError, match="cannot listen"):
            second.open(StillNode())
    finally:
        first.close()


def test_a_viewer_sees_charts_as_points_and_rows() -> None:
    sink = Foxglove(FoxgloveSettings(port=0, every_s=0.0), small_array())
    sink.open(StillNode())
    chart = some_chart(20)
    try:
        address = sink.where()
        assert address is not None
        with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as viewer:
            channels: dict[str, int] = {}
            while len(channels) < 4:
                message = json.loads(viewer.recv(10))
                channels |= {c["topic"]: c["id"] for c in message.get("channels", [])}
            assert set(channels) == {"/chart/lab/points", "chart.lab", "quality.lab", "status.lab"}
            wanted = [{"id": i, "channelId": number} for i, number in enumerate(channels.values())]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            names = list(channels)
            seen: dict[str, Any] = {}
            for _ in range(200):
                sink.on_chart(chart)
                sink.on_quality(QUALITY)
                try:
                    message = viewer.recv(0.05)
                except TimeoutError:
                    continue
                if isinstance(message, bytes) and message[0] == 1:
                    (number,) = struct.unpack_from("<I", message, 1)
                    seen[names[number]] = json.loads(message[13:])
                if {"/chart/lab/points", "chart.lab", "quality.lab"} <= set(seen):
                    break
    finally:
        sink.close()
    points = np.frombuffer(base64.b64decode(seen["/chart/lab/points"]["data"]), POINT)
    np.testing.assert_array_equal(points["ue"], chart.ue)
    np.testing.assert_allclose(points["x"], chart.x, rtol=1e-6)
    assert seen["chart.lab"]["ue"] == chart.ue.tolist()
    assert seen["quality.lab"]["tw"] == QUALITY["tw"]
