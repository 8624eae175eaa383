"""The sinks that people and programs talk to keep the contract of all sinks."""

from __future__ import annotations

from urllib.parse import urlsplit

import pytest
from csi_samples import small_array
from sink_contract import SinkCase, SinkContract

from chachart.sinks.base import Sink

TOKEN = "open-sesame-open-sesame"
ELSEWHERE = {"host": "192.0.2.1", "token": TOKEN}


def taken_port(sink: Sink) -> dict[str, object]:
    return {"port": urlsplit(sink.where() or "").port}


class TestControl(SinkContract):
    @pytest.fixture
    def case(self) -> SinkCase:
        return SinkCase(
            "control",
            {"endpoint": "tcp://127.0.0.1:0"},
            small_array(),
            impossible={"endpoint": "tcp://192.0.2.1:5557", "token": TOKEN},
            taken=lambda sink: {"endpoint": sink.where()},
        )


class TestMetrics(SinkContract):
    @pytest.fixture
    def case(self) -> SinkCase:
        return SinkCase("metrics", {"port": 0}, small_array(), impossible=ELSEWHERE, taken=taken_port)


class TestView(SinkContract):
    @pytest.fixture
    def case(self) -> SinkCase:
        return SinkCase("view", {"port": 0}, small_array(), impossible=ELSEWHERE, taken=taken_port)
