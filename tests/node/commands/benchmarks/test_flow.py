from __future__ import annotations

import argparse

import pytest

from chachart.node.commands.benchmarks import flow


def test_it_measures_recordings_wire_and_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "CHART_UES", (16,))
    recordings, wire, charts = flow.run(argparse.Namespace(frames=128, runs=2))
    assert [row[0] for row in recordings.rows] == [row[0] for row in wire.rows] == [64, 1]
    assert [row[0] for row in charts.rows] == [16]
    for table in (recordings, wire, charts):
        assert all(cell is not None for row in table.rows for cell in row)
        assert len(table.as_dict()["rows"]) == len(table.rows)
