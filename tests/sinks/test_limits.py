"""Files that lead elsewhere, and answers as long as the chart."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zmq
from chart_samples import StillNode, some_chart
from csi_samples import small_array, some_block
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from chachart.node.data.errors import RequestError
from chachart.node.files.recording import RecordingWriter
from chachart.node.net.security import Role
from chachart.sinks.control import Control, ControlSettings
from chachart.sinks.operations import CHANGING, READING, Operations
from chachart.sinks.recorder import Recorder, RecorderSettings
from chachart.sinks.recordings import Recordings
from chachart.sinks.view.sink import View, ViewSettings
from chachart.sinks.web.server import MAX_MESSAGE_BYTES


class CountingNode(StillNode):
    """Counts how often it is asked for its chart."""

    asked = 0

    def chart_columns(self) -> Mapping[str, Any]:
        self.asked += 1
        return {"ue": [1, 2]}


def encode(values: Mapping[str, Any]) -> bytes:
    return json.dumps(dict(values)).encode()


def test_the_whole_chart_is_put_together_once_a_second(tmp_path: Path) -> None:
    node = CountingNode(some_chart())
    operations = Operations(node, tmp_path)  # type: ignore[arg-type]
    replies = {operations.reply({"op": "chart"}, Role.READER, encode) for _ in range(100)}
    assert replies == {b'{"ue": [1, 2]}'}
    assert node.asked <= 2, "a hundred requests in a moment"


@pytest.mark.parametrize("op", [*CHANGING, "fly", None, ["status"]])
def test_who_may_only_read_changes_nothing(tmp_path: Path, op: object) -> None:
    operations = Operations(StillNode(), tmp_path)  # type: ignore[arg-type]
    with pytest.raises(RequestError, match="may only read"):
        operations.perform(
            {"op": op, "on": True, "path": "a.mcap", "theta": "music", "rho": "music"}, Role.READER
        )
    assert list(tmp_path.iterdir()) == []
    assert "status" in READING


def test_no_link_leads_out_of_the_recording_folder(tmp_path: Path) -> None:
    outside, folder = tmp_path / "outside.mcap", tmp_path / "recordings"
    folder.mkdir()
    with RecordingWriter(outside, small_array()) as writer:
        writer.write(some_block(3))
    (folder / "link.mcap").symlink_to(outside)
    (folder / "target.mcap").symlink_to(tmp_path / "new.mcap")
    os.mkfifo(folder / "pipe.mcap")
    (folder / "good.mcap").write_bytes(outside.read_bytes())
    recordings = Recordings(folder)
    assert [r["name"] for r in recordings.list()["recordings"]] == ["good.mcap"]
    assert recordings.content("good.mcap") == outside.read_bytes()
    for name in ("link.mcap", "pipe.mcap", "../outside.mcap", "a\r\nX: y.mcap", "", "good.mcap\0", "."):
        with pytest.raises(RequestError, match="there is no recording"):
            recordings.content(name)
    recorder = Recorder(RecorderSettings(path=folder / "target.mcap"), small_array())
    recorder.open(None)
    recorder.close()
    assert not (tmp_path / "new.mcap").exists(), "a link is not followed, even where nothing is yet"


def test_a_flood_of_requests_is_told_to_wait() -> None:
    sink = Control(ControlSettings(endpoint="tcp://127.0.0.1:0"), small_array())
    sink.security = sink.security.model_copy(update={"max_requests_per_s": 2.0})
    sink.open(StillNode(some_chart()))  # type: ignore[arg-type]
    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.linger = 0
        socket.connect(sink.where() or "")
        replies = []
        for _ in range(14):
            socket.send(b'{"op": "status"}')
            while not socket.poll(10):
                sink.on_tick()
            replies.append(json.loads(socket.recv()))
    assert [reply["ok"] for reply in replies[:10]] == [True] * 10
    assert "too many requests" in replies[-1]["error"]
    assert sink.refused.as_dict()["too_many_requests"] >= 2
    sink.close()


def test_nobody_sends_more_by_packing_it(tmp_path: Path) -> None:
    """Nothing is unpacked, so a kilobyte cannot become a gigabyte; long messages end the connection."""
    view = View(ViewSettings(port=0, record_folder=tmp_path), small_array())
    view.open(StillNode(some_chart()))  # type: ignore[arg-type]
    where = (view.where() or "").replace("http", "ws")

    async def send() -> int | None:
        async with connect(f"{where}ws", compression="deflate") as viewer:
            assert viewer.protocol.extensions == []
            with suppress(ConnectionClosed):
                await viewer.send("x" * (MAX_MESSAGE_BYTES + 1))
                async for _ in viewer:
                    pass
            return viewer.close_code

    assert asyncio.run(send()) == 1009
    view.close()
