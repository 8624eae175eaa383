"""A recording that is played in a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from browser import browse, wait
from chart_logs import write_recording
from live_node import LiveNode, free_port, until

from chachart.node.commands.main import main
from chachart.node.files.recording import RecordingReader, RecordingWriter


@pytest.fixture
def node(tmp_path: Path) -> Iterator[LiveNode]:
    """Plays 60 UEs, twelve frames each, for a minute; it stays after the end."""
    write_recording(tmp_path / "walk.mcap", ues=60, frames=720)
    changes = [
        "source.speed=0.02",
        f"sinks.view.port={free_port()}",
        f"sinks.control.endpoint=ipc://{tmp_path}/control",
    ]
    with LiveNode.told(tmp_path, "walk.mcap", "--set", *changes) as node:
        yield node


def test_a_recording_is_paused_wound_and_goes_back_from_its_end(
    node: LiveNode, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with browse(node.address("view")) as (page, complaints):
        page.wait_for_selector("#replay:not([hidden])")
        page.wait_for_selector("#link:has-text('replay')")
        wait(page, "chachart.world.rows > 0")
        page.keyboard.press(" ")
        page.wait_for_selector("#link[data-state=paused]")
        length = float(page.get_attribute("#seek", "max") or 0)
        page.evaluate(
            """to => {
            const seek = document.getElementById('seek');
            seek.value = to;
            seek.dispatchEvent(new Event('change'));
        }""",
            0.9 * length,
        )

        def at() -> float:
            return float(node.ask("api/status")["source_details"]["replay"]["at_s"])

        until(lambda: at() == pytest.approx(0.9 * length, abs=0.05), "it has jumped")
        page.select_option("#speed", "10")
        page.focus("#plot")
        page.keyboard.press(" ")
        page.wait_for_selector("#link:has-text('end of the recording')")
        assert "end" in page.inner_text("#at")
        page.click("#play")
        wait(page, "chachart.world.rows === 60")
        assert complaints == []
        page.click("#record")
        page.wait_for_selector("#recordings td:has-text('walk.mcap')")
        with page.expect_download() as kept:
            page.click("#recordings a")
        kept.value.save_as(tmp_path / "kept.mcap")
    assert (tmp_path / "kept.mcap").read_bytes() == (tmp_path / "walk.mcap").read_bytes()
    endpoint = f"ipc://{tmp_path}/control"
    assert main(["ctl", "--endpoint", endpoint, "replay", "--pause", "--at", "0"]) == 0
    assert "0.0 s of" in (said := capsys.readouterr().out)
    assert "paused" in said
    assert main(["ctl", "--endpoint", endpoint, "replay", "--at", "1e9"]) == 78


def test_the_end_of_a_node_is_no_alarm(tmp_path: Path) -> None:
    node = LiveNode(tmp_path, f'[[sinks]]\ntype = "view"\nport = {free_port()}')
    with node, browse(node.address("view")) as (page, _):
        page.wait_for_selector("#link[data-state=live]")
        assert node.stop() == 0
        page.wait_for_selector("#link[data-state=ended]")
        assert "has ended, as it should" in page.inner_text("#gone")


def test_a_dead_antenna_is_shown_to_everybody(tmp_path: Path) -> None:
    reader = RecordingReader(write_recording(tmp_path / "well.mcap"))
    with RecordingWriter(tmp_path / "ill.mcap", reader.array) as writer:
        for block in reader.blocks():
            csi = block.csi.copy()
            csi[:, 2] *= 1e-3
            writer.write(replace(block, csi=csi))
    changes = [
        "source.loops=0",
        f"sinks.view.port={free_port()}",
        f"sinks.control.endpoint=ipc://{tmp_path}/c",
    ]
    with (
        LiveNode.told(tmp_path, "ill.mcap", "--set", *changes) as node,
        browse(node.address("view")) as (page, complaints),
    ):
        page.wait_for_selector("#antennafaults:has-text('antenna 2 dead')")
        assert node.ask("api/status")["antennas"]["faults"] == {"2": "dead"}
        assert (
            'chachart_antenna_fault{antenna="2",fault="dead"} 1.0'
            in node.get(f"{node.address('view')}metrics")[1]
        )
        assert "antenna 2 looks dead" in node.said()
        page.keyboard.press("n")
        page.click("#response summary")
        wait(page, "document.getElementById('uephase').width > 300")
        assert complaints == []
