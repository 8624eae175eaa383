"""One node for every test of these folders that leaves it as it found it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from live_node import LiveNode

TOKEN = "open-sesame-open-sesame"
SINKS = f"""
[security]
trust_local = true
[[sinks]]
type = "view"
port = 0
rate_hz = 20.0
max_viewers = 60
token = "{TOKEN}"
[[sinks]]
type = "metrics"
port = 0
stale_after_s = 0.001
[[sinks]]
type = "control"
endpoint = "tcp://127.0.0.1:0"
"""


@pytest.fixture(scope="package")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveNode]:
    """A node with everything that people and programs can talk to."""
    with LiveNode(tmp_path_factory.mktemp("node"), SINKS) as running:
        yield running


@pytest.fixture
def token() -> str:
    """What the node's view wants of people from elsewhere."""
    return TOKEN
