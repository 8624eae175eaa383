from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from chart_samples import QUALITY, STATUS, StillNode, some_chart
from csi_samples import small_array
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from sink_contract import SinkCase, SinkContract

from chachart.node.data.chart import ChartUpdate
from chachart.sinks.chart_log import ChartLog, ChartLogSettings


class TestContract(SinkContract):
    @pytest.fixture
    def case(self, tmp_path: Path) -> SinkCase:
        settings = {"path": tmp_path / "chart-{time}.mcap"}
        return SinkCase("chart_log", settings, small_array(), impossible={"path": tmp_path / "no" / "a.mcap"})


def chart_log(path: Path, **settings: Any) -> ChartLog:
    log = ChartLog(ChartLogSettings(path=path, **settings), small_array())
    log.open(StillNode())
    return log


def messages(path: Path) -> list[tuple[str, str, dict[str, Any]]]:
    """Topic, schema and content of each message, as an MCAP tool reads them."""
    with path.open("rb") as file:
        read = []
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            decode = json.loads if channel.message_encoding == "json" else msgpack.unpackb
            read.append((channel.topic, schema.name, decode(message.data)))
        return read


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_mcap_tools_read_charts_quality_and_status(tmp_path: Path, encoding: str) -> None:
    chart = some_chart(6)
    log = chart_log(tmp_path / "a.mcap", encoding=encoding, every_s=0)
    log.on_chart(chart)
    log.on_quality(QUALITY)
    log.on_status(STATUS)
    log.close()
    (topic, schema, values), quality, status = messages(tmp_path / "a.mcap")
    assert (topic, schema) == ("chart.lab", "chachart.chart")
    assert values["array"] == "lab"
    assert values["method"] == {"theta": "bartlett", "rho": "isq"}
    assert values["ue"] == chart.ue.tolist()
    assert values["time_ns"] == chart.time_ns.tolist()
    np.testing.assert_allclose(values["theta"], chart.theta, atol=1e-6)
    np.testing.assert_allclose(values["x"], chart.x, atol=1e-3)
    assert values["theta_std"] == [None] * 6
    assert values["position"][5] == [None] * 3
    assert chart.position is not None
    np.testing.assert_allclose(values["position"][:3], chart.position[:3], atol=1e-3)
    assert quality == ("quality.lab", "chachart.quality", {"array": "lab", **QUALITY, "stress": None})
    assert status == ("status.lab", "chachart.status", {"array": "lab", **STATUS})


def test_the_schema_lists_what_is_written(tmp_path: Path) -> None:
    log = chart_log(tmp_path / "a.mcap", every_s=0)
    log.on_chart(some_chart())
    log.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        [(schema, _, message)] = make_reader(file).iter_messages()
    assert schema is not None
    assert schema.encoding == "jsonschema"
    known = json.loads(schema.data)
    assert set(known["required"]) <= json.loads(message.data).keys() <= known["properties"].keys()


def test_updates_are_gathered(tmp_path: Path) -> None:
    """The first is written at once; what comes in `every_s` after it is one message, each UE's newest row."""
    log = chart_log(tmp_path / "a.mcap", every_s=3600)
    updates = [some_chart(5, seed=1), some_chart(5, seed=2), some_chart(5, first_ue=3, seed=3)]
    for update in updates:
        log.on_chart(update)
        log.on_tick()
    log.close()
    first, rest = (values for _, _, values in messages(tmp_path / "a.mcap"))
    assert first["ue"] == [0, 1, 2, 3, 4]
    merged = ChartUpdate.concatenate(updates[1:])
    assert rest["ue"] == merged.ue.tolist()
    np.testing.assert_allclose(rest["rho"], merged.rho, atol=1e-3)


def test_files_are_rotated_by_size(tmp_path: Path) -> None:
    log = chart_log(tmp_path / "a.mcap", every_s=0, max_bytes=1024**2)
    for n in range(12):
        log.on_chart(some_chart(4096, seed=n))
    log.close()
    paths = sorted(tmp_path.iterdir())
    assert len(paths) > 1
    rows = [len(values["ue"]) for path in paths for _, _, values in messages(path)]
    assert sum(rows) == 12 * 4096


def test_a_log_that_was_not_closed_can_be_read(tmp_path: Path) -> None:
    log = chart_log(tmp_path / "a.mcap", every_s=0)
    log.on_chart(some_chart())
    log.on_tick()
    (tmp_path / "b.mcap").write_bytes((tmp_path / "a.mcap").read_bytes())
    log.close()
    with (tmp_path / "b.mcap").open("rb") as file:
        read = NonSeekingReader(file).iter_messages(log_time_order=False)
        assert next(read)[1].topic == "chart.lab"
        with pytest.raises(EndOfFile):
            next(read)


def test_foxglove_gets_point_clouds(tmp_path: Path) -> None:
    """One a write however many UEs, as Foxglove's documentation of foxglove.PointCloud has it."""
    chart = some_chart(5000)
    log = chart_log(tmp_path / "a.mcap", every_s=0, foxglove=True, encoding="msgpack")
    log.on_chart(chart)
    log.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        read = [m for m in make_reader(file).iter_messages() if m[1].topic == "/chart/lab/points"]
    [(schema, channel, message)] = read
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "foxglove.PointCloud",
        "jsonschema",
        "json",
    )
    described = json.loads(schema.data)["properties"]
    cloud = json.loads(message.data)
    assert cloud.keys() == described.keys()
    assert described["data"] == {"type": "string", "contentEncoding": "base64"}
    assert cloud["timestamp"]["sec"] * 10**9 + cloud["timestamp"]["nsec"] <= message.log_time
    assert cloud["frame_id"] == "lab"
    numeric = {7: "<f4", 8: "<f8"}
    point = np.dtype(
        {
            "names": [f["name"] for f in cloud["fields"]],
            "formats": [numeric[f["type"]] for f in cloud["fields"]],
            "offsets": [f["offset"] for f in cloud["fields"]],
            "itemsize": cloud["point_stride"],
        }
    )
    points = np.frombuffer(base64.b64decode(cloud["data"]), point)
    np.testing.assert_array_equal(points["ue"], chart.ue)
    np.testing.assert_allclose(points["x"], chart.x, rtol=1e-6)
    np.testing.assert_allclose(points["y"], chart.y, rtol=1e-6)
    np.testing.assert_allclose(points["snr"], chart.snr, rtol=1e-6)
