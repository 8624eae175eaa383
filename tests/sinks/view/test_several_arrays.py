"""The page of a node that fuses several arrays, in headless Chromium."""

from __future__ import annotations

from pathlib import Path

from browser import DRAWN, browse, wait
from live_node import LiveNode
from raytraced_archives import write_archive

from chachart.node.commands.main import main


def test_the_page_shows_all_arrays_and_what_they_say_of_a_ue(tmp_path: Path) -> None:
    recording = tmp_path / "walk.mcap"
    archive = write_archive(tmp_path / "walk.npz")
    assert main(["import", str(archive), str(recording), "--snr-db", "20"]) == 0
    changes = ["source.loops=0", "tracking.motion=walk", "sinks.view.port=0"]
    with (
        LiveNode.told(tmp_path, str(recording), "--set", *changes) as node,
        browse(node.address("view")) as (page, complaints),
    ):
        page.wait_for_selector("#link[data-state=live]")
        wait(page, "window.chachart?.world.rows === 2")
        assert page.evaluate("chachart.picture.pose.arrays.length") == 3
        assert page.evaluate("chachart.picture.pose.world")
        page.wait_for_selector("#arrays:not([hidden])")
        wait(page, "document.querySelectorAll('#arraytable tbody tr').length === 3")
        wait(page, "document.querySelector('#arraytable').innerText.includes('100 %')")
        page.wait_for_selector("#method", state="hidden")
        page.fill("#ue", "1")
        page.press("#ue", "Enter")
        page.wait_for_selector("#bearings:not([hidden])")
        wait(page, "chachart.picture.bearings.length === 3")
        for curve in ("#bearingplot", "#farplot", "#thetaplot", "#over"):
            wait(page, DRAWN, arg=curve)
        assert "Speed" in page.inner_text("#userfacts")
        off = page.evaluate(
            """() => {
                const { world, picture } = chachart;
                const row = world.index.get(1n);
                return picture.bearings.map(({ at, angle }) => {
                    const truth = Math.atan2(world.y[row] - at[1], world.x[row] - at[0]);
                    return Math.abs(Math.atan2(Math.sin(angle - truth), Math.cos(angle - truth)));
                });
            }"""
        )
        assert max(off) < 0.3
        page.wait_for_timeout(100)
        assert complaints == []
