"""A real node's view as programs see it: HTTP and the WebSocket, without a browser."""

from __future__ import annotations

import asyncio
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from live_node import LiveNode, tool, until
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from chachart.node.net.security import Role, Tokens
from chachart.sinks.view.sink import PAGE

VIEWERS = 50


def socket_of(node: LiveNode) -> str:
    return node.address("view").replace("http", "ws") + "ws"


async def next_message(viewer: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of a kind; of a chart frame, its header."""
    async with asyncio.timeout(60):
        while True:
            data = await viewer.recv()
            if isinstance(data, bytes):
                message = json.loads(data[4 : 4 + int.from_bytes(data[:4], "little")])
            else:
                message = json.loads(data)
            if message["type"] == kind:
                return dict(message)


async def ask(viewer: ClientConnection, op: str, **arguments: Any) -> dict[str, Any]:
    await viewer.send(json.dumps({"id": 1, "op": op, **arguments}))
    return await next_message(viewer, "answer")


def test_every_file_of_the_page_is_served_under_a_strict_policy(node: LiveNode) -> None:
    for file in PAGE.iterdir():
        status, body = node.get(node.address("view") + file.name)
        assert (status, body) == (200, file.read_text())
    assert node.get(node.address("view"))[1] == (PAGE / "index.html").read_text()
    text = "".join(file.read_text() for file in PAGE.iterdir()).replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in text.replace("https:'", "")
    assert "http://" not in text


def test_health_and_metrics(node: LiveNode) -> None:
    view, metrics = node.address("view"), node.address("metrics").removesuffix("metrics")
    until(lambda: node.get(f"{view}readyz") == (200, "ready\n"), "ready")
    status, reason = until(lambda: node.get(f"{metrics}readyz"), "an answer")
    assert (status, reason.split(" for ")[0]) == (503, "no frame"), "this one is told to be impatient"
    for base in (view, metrics):
        assert node.get(f"{base}healthz") == (200, "alive\n")
        status, text = node.get(f"{base}metrics")
        assert status == 200
        assert 'chachart_state{state="running"} 1.0' in text
        assert "chachart_latency_seconds_bucket" in text
        assert "chachart_ues 60.0" in text


def test_prometheus_finds_nothing_to_complain_about(node: LiveNode) -> None:
    promtool = tool("promtool", "prometheus")
    metrics = node.get(node.address("metrics"))[1]
    checked = subprocess.run([promtool, "check", "metrics"], input=metrics, capture_output=True, text=True)
    assert (checked.returncode, checked.stdout + checked.stderr) == (0, "")


def test_reading_over_http(node: LiveNode) -> None:
    until(lambda: node.ask("api/status")["ues"] == 60, "all UEs are there")
    assert len(node.ask("api/ues")["ues"]) == 60
    assert node.ask("api/chart")["type"] == "chart"
    spectrum = node.ask("api/spectrum?ue=7")
    assert len(spectrum["theta_grid_rad"]) == len(spectrum["theta_spectrum"]) > 50


@pytest.mark.parametrize(
    ("method", "path", "status", "word"),
    [
        ("GET", "api/nonsense", 404, "api/nonsense"),
        ("GET", "api/method?theta=music&rho=music", 405, "POST"),
        ("POST", "api/status", 405, "GET"),
        ("GET", "api/spectrum", 400, "ue"),
        ("GET", "api/spectrum?ue=-1", 400, "ue"),
        ("GET", "api/spectrum?ue=999999", 400, "999999"),
        ("GET", "api/status?verbose=1", 400, "verbose"),
        ("POST", "api/method?theta=musik&rho=bartlett", 400, "theta"),
        ("POST", "api/method?theta=music", 400, "rho"),
        ("POST", "api/record?on=true", 400, "path"),
        ("POST", "api/record?on=true&path=../out.mcap", 400, "path"),
        ("POST", "api/record?on=true&path=/etc/out.mcap", 400, "path"),
        ("POST", "api/record?on=perhaps", 400, "on"),
        ("POST", "api/record?on=false", 400, "no recording"),
    ],
)
def test_bad_requests_get_an_error_and_change_nothing(
    node: LiveNode, method: str, path: str, status: int, word: str
) -> None:
    before = node.ask("api/status")
    answered, body = node.get(node.address("view") + path, method)
    assert answered == status
    assert word in body
    after = node.ask("api/status")
    assert (after["method"], after["recording"]) == (before["method"], before["recording"])


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 401),
        ({"X-Forwarded-For": "10.0.0.7"}, 401),
        ({"Authorization": "Bearer wrong", "X-Forwarded-For": "10.0.0.7"}, 401),
        ({"Origin": "http://evil.example"}, 403),
    ],
)
def test_strangers_are_turned_away(node: LiveNode, headers: dict[str, str], status: int) -> None:
    view = node.address("view")
    for path in ("", "main.js", "api/status", "metrics", "healthz"):
        assert node.get(view + path, headers=headers)[0] == status
    assert node.get(view + "api/method?theta=music&rho=music", "POST", headers)[0] == status

    async def come() -> None:
        async with connect(socket_of(node), additional_headers=headers):
            pytest.fail("let in")

    with pytest.raises(InvalidStatus, match=r"HTTP 40[013]"):
        asyncio.run(come())


def test_the_token_opens(node: LiveNode, token: str) -> None:
    far = {"X-Forwarded-For": "10.0.0.7"}
    url = node.address("view") + "api/status"
    assert node.get(url, headers={**far, "Authorization": f"Bearer {token}"})[0] == 200
    assert node.get(f"{url}?token={token}", headers=far)[0] == 200
    port = node.address("view").rstrip("/").rpartition(":")[2]
    cookie = f"chachart_token_{port}={Tokens(token).cookie(Role.STEERER)}"
    assert node.get(url, headers={**far, "Cookie": cookie})[0] == 200
    assert node.get(url, headers={**far, "Cookie": f"chachart_token_{port}={token}"})[0] == 401
    assert "token" in node.get(node.address("view"), headers=far)[1]


def test_a_recording_holds_frames_and_is_never_overwritten(node: LiveNode, tmp_path: Path) -> None:
    assert node.ask("api/record?on=true&path=one.mcap", "POST")["on"] is True
    until(lambda: node.ask("api/status")["recording"], "the status says so")
    until(lambda: "chachart_recorder_bytes{" in node.get(node.address("metrics"))[1], "metrics say so")
    file = node.folder / "one.mcap"
    until(lambda: file.stat().st_size > 10_000, "frames are in the file")
    assert node.ask("api/record?on=false", "POST")["on"] is False
    size = file.stat().st_size
    status, body = node.get(node.address("view") + "api/record?on=true&path=one.mcap", "POST")
    assert status == 400
    assert "never overwritten" in body
    assert file.stat().st_size == size


async def hear(node: LiveNode) -> None:
    async with connect(socket_of(node)) as viewer:
        hello = await next_message(viewer, "hello")
        assert hello["array"]["antennas"] == 8
        assert "music" in hello["methods"]["theta"]
        whole = await next_message(viewer, "chart")
        assert whole["full"] is True
        assert (await next_message(viewer, "chart"))["full"] is False
        assert (await next_message(viewer, "status"))["state"] == "running"
        assert 0 < (await next_message(viewer, "quality"))["tw"] <= 1
        curve = (await ask(viewer, "curve"))["result"]
        assert len(curve["k"]) == len(curve["tw"]) == len(curve["ct"]) > 2
        assert (await ask(viewer, "spectrum", ue="7"))["result"]["theta"] > 0
        for wrong in (
            '"text"',
            "[]",
            "{",
            '{"op": "fly"}',
            '{"op": "spectrum"}',
            "\ud800".encode("utf-8", "replace"),
        ):
            await viewer.send(wrong)
            assert "error" in await next_message(viewer, "answer")
        await ask(viewer, "sync")
        while not (await next_message(viewer, "chart"))["full"]:
            pass
        await ask(viewer, "stream", on=False)
        await next_message(viewer, "status")
        await ask(viewer, "stream", on=True)
        while not (await next_message(viewer, "chart"))["full"]:
            pass


def test_what_a_viewer_hears(node: LiveNode) -> None:
    until(lambda: node.ask("api/status")["ues"] == 60, "all UEs are there")
    asyncio.run(hear(node))


def test_fifty_viewers_one_of_them_stalled(node: LiveNode) -> None:
    """The stalled one asks for charts until its pipe is full; the others go on as if it were not there."""

    async def run() -> tuple[list[int], int]:
        counts = [0] * VIEWERS
        asked = 0

        async def look(i: int, enough: int) -> None:
            async with connect(socket_of(node)) as viewer:
                while counts[i] < enough:
                    await next_message(viewer, "chart")
                    counts[i] += 1

        async with connect(socket_of(node), max_queue=1) as stalled, asyncio.timeout(60):
            for asked in range(1, 2000):
                try:
                    async with asyncio.timeout(0.5):
                        await stalled.send(json.dumps({"id": asked, "op": "chart"}).ljust(15_000))
                except TimeoutError:
                    break
            await asyncio.gather(*(look(i, 30) for i in range(VIEWERS - 1)))
            stalled.transport.abort()
        return counts, asked

    memory = resident_kib(node)
    counts, asked = asyncio.run(run())
    assert min(counts[:-1]) >= 30
    assert asked < 1999, "the node reads no further from somebody who does not listen"
    assert resident_kib(node) < memory + 100_000
    assert node.get(node.address("view") + "readyz")[0] == 200


def resident_kib(node: LiveNode) -> int:
    for line in Path(f"/proc/{node.pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    raise AssertionError("the node is gone")


def test_a_viewer_too_many_is_told_so(node: LiveNode) -> None:
    async def run() -> tuple[int | None, str | None]:
        async with asyncio.timeout(60), asyncio.TaskGroup() as group:
            viewers = [await connect(socket_of(node)) for _ in range(60)]
            late = await connect(socket_of(node))
            await late.wait_closed()
            for viewer in viewers:
                group.create_task(viewer.close())
            return late.close_code, late.close_reason

    code, reason = asyncio.run(run())
    assert code == 1013
    assert "Too many" in (reason or "")
