"""The JavaScript subscriber of PROTOCOL.md, as it stands there, at a node with keys."""

from __future__ import annotations

import os
import re
import subprocess
import threading
from pathlib import Path

import pytest
from chart_samples import QUALITY, StillNode, some_chart
from csi_samples import small_array
from live_node import tool

from chachart.node.net.keys import KeyPair, allow, load_public, new_pair
from chachart.node.net.security import SecuritySettings
from chachart.sinks.publisher import Publisher, PublisherSettings

MODULES = os.environ.get("CHACHART_NODE_MODULES")
PAGE = Path(__file__).parents[3] / "node/net/PROTOCOL.md"


@pytest.mark.skipif(not MODULES, reason="CHACHART_NODE_MODULES names no node_modules with zeromq and msgpack")
def test_the_subscriber_of_the_page_gets_the_chart(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    new_pair(keys, "node")
    public, secret = new_pair(tmp_path, "ana")
    allow(keys, public, "read")
    mine = KeyPair.load(secret)
    sink = Publisher(PublisherSettings(endpoint="tcp://127.0.0.1:0"), small_array())
    sink.security = SecuritySettings(keys=keys)
    sink.open(StillNode(some_chart(20, seed=4), QUALITY))
    [program] = re.findall(r"```js\n(.*?)```", PAGE.read_text(), re.S)
    for name, value in (
        ("curvePublicKey", mine.public.decode()),
        ("curveSecretKey", mine.secret.decode()),
        ("curveServerKey", load_public(keys / "node.key").decode()),
    ):
        program = program.replace(f"{name}: '…'", f"{name}: '{value}'")
    program = program.replace("tcp://node.lab:5556", sink.where() or "")
    program = program.replace("chart.y[0])\n", "chart.y[0])\n  break\n")
    (tmp_path / "subscriber.mjs").write_text(program)
    (tmp_path / "node_modules").symlink_to(Path(MODULES or "").absolute())
    over = threading.Event()

    def serve() -> None:
        while not over.wait(0.01):
            sink.on_tick()

    server = threading.Thread(target=serve)
    server.start()
    try:
        command = [tool("node", "nodejs"), str(tmp_path / "subscriber.mjs")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    finally:
        over.set()
        server.join()
        sink.close()
    assert done.stdout.startswith("20 UEs, the first at "), done.stderr
