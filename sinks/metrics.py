"""Metrics and health of a node that has no live view."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from chachart.sinks.base import SinkSettings
from chachart.sinks.web.settings import WebSettings
from chachart.sinks.web.sink import WebSink


class MetricsSettings(WebSettings):
    """`type = "metrics"`: /metrics, /healthz and /readyz for a node without a live view."""

    type: Literal["metrics"] = "metrics"
    port: int = Field(9464, ge=0, le=65535)
    """TCP port; 0 takes a free one."""


class Metrics(WebSink):
    """Serves metrics and health over HTTP."""

    Settings: ClassVar[type[SinkSettings]] = MetricsSettings
    page = "/metrics"
