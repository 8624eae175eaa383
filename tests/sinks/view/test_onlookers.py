"""People who may only look, and what they take away, in a real browser."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from browser import browse, wait
from chart_logs import write_recording
from live_node import LiveNode, free_port

STEER, READ = "steer-steer-steer-steer", "read-read-read-read"
STEERING = ("#theta", "#rho", "#record")


@pytest.fixture
def node(tmp_path: Path) -> LiveNode:
    """An array whose name is a formula, on a page that wants a token."""
    (tmp_path / "named.toml").write_text(
        f"""
        [security]
        token = "{STEER}"
        read_token = "{READ}"
        [array]
        name = "-lab"
        antennas = 8
        subcarriers = 8
        subcarrier_spacing_hz = 312500.0
        height_m = 8.5
        [source]
        type = "simulator"
        layout = "uniform"
        ues = 20
        frame_rate_hz = 200.0
        [[sinks]]
        type = "view"
        port = {free_port()}
        """
    )
    return LiveNode.told(tmp_path, "--config", str(tmp_path / "named.toml"))


def test_a_page_that_may_only_look_steers_nothing_and_says_why(node: LiveNode, tmp_path: Path) -> None:
    with node, browse(f"{node.address('view')}?token={READ}") as (page, complaints):
        wait(page, "window.chachart?.world.rows === 20")
        assert page.inner_text("#onlylook") == "view only"
        for control in STEERING:
            assert page.is_disabled(control), control
            assert "steering token" in (page.get_attribute(control, "title") or ""), control
        page.keyboard.press("r")
        assert page.is_hidden("#recording")
        page.click("#plan")
        assert page.is_disabled("#planfile")
        assert "steering token" in page.inner_text("#planhint")
        page.keyboard.press("Escape")
        with page.expect_download() as table:
            page.click("#csv")
        table.value.save_as(tmp_path / "chart.csv")
        page.goto(f"{node.address('view')}?token={STEER}")
        wait(page, "window.chachart?.world.rows === 20")
        assert page.is_hidden("#onlylook")
        for control in STEERING:
            assert page.is_enabled(control), control
            assert "token" not in (page.get_attribute(control, "title") or ""), control
        assert complaints == []
    with (tmp_path / "chart.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["array"] for row in rows} == {"'-lab"}
    assert sorted(int(row["ue"]) for row in rows) == list(range(20))


def test_who_may_only_look_sees_a_replay_and_leaves_it_alone(tmp_path: Path) -> None:
    write_recording(tmp_path / "walk.mcap", ues=20, frames=200)
    port = free_port()
    changes = [f"sinks.view.port={port}", f"security.token={STEER}", f"security.read_token={READ}"]
    changes += ["source.speed=0.02", f"sinks.control.endpoint=ipc://{tmp_path}/control"]
    node = LiveNode.told(tmp_path, "walk.mcap", "--set", *changes)
    with node, browse(f"http://127.0.0.1:{port}/?token={READ}") as (page, complaints):
        page.wait_for_selector("#replay:not([hidden])")
        wait(page, "window.chachart?.world.rows > 0")
        for control in ("#play", "#seek", "#speed"):
            assert page.is_disabled(control), control
        page.keyboard.press(" ")
        asked = page.evaluate("chachart.stream.ask('replay').then(found => found)")
        assert len(asked["density"]) > 10
        assert not asked["paused"]
        told = "chachart.stream.ask('replay', { paused: true }).catch(error => error.message)"
        assert "may only read" in page.evaluate(told)
        assert page.is_hidden("#toast")
        assert complaints == []
