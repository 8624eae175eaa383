from __future__ import annotations

import json
from pathlib import Path

import pytest
from chart_samples import QUALITY, StillNode
from csi_samples import small_array
from sink_contract import SinkCase, SinkContract

from chachart.sinks.quality_log import QualityLog, QualityLogSettings


class TestContract(SinkContract):
    @pytest.fixture
    def case(self, tmp_path: Path) -> SinkCase:
        path = tmp_path / "quality.jsonl"
        return SinkCase(
            "quality_log", {"path": path}, small_array(), impossible={"path": tmp_path / "no" / "q"}
        )


def test_each_report_is_a_line_at_once(tmp_path: Path) -> None:
    path = tmp_path / "quality.jsonl"
    for start in range(2):
        log = QualityLog(QualityLogSettings(path=path), small_array())
        log.open(StillNode())
        log.on_quality({**QUALITY, "ues": start})
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        assert len(lines) == start + 1
        assert lines[-1].pop("time_ns") > 0
        assert lines[-1] == {"array": "lab", **QUALITY, "ues": start, "stress": None}
        log.close()
