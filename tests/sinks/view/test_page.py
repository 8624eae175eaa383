"""The real page in headless Chromium against a real node."""

from __future__ import annotations

import csv
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from browser import DRAWN, browse, wait
from live_node import LiveNode, free_port, until
from PIL import Image
from playwright.sync_api import Page

PLACE = """(row) => {
    const { world, picture } = window.chachart;
    const pane = picture.view.panes().at(-1);
    const box = document.getElementById('plot').getBoundingClientRect();
    const x = box.x + 1 + pane.x0 + world.px[row] * pane.scale;
    return [x, box.y + 1 + pane.y0 - world.py[row] * pane.scale];
}"""
"""Where on the page a row of the table is drawn."""


def all_there(page: Page) -> None:
    page.wait_for_selector("#plot")
    wait(page, "window.chachart?.world.rows === 60")


def test_points_move_a_click_shows_spectra_and_the_method_changes(tmp_path: Path) -> None:
    port = free_port()
    sinks = f'[[sinks]]\ntype = "view"\nport = {port}'
    source = 'motion = "waypoint"\nspeed_m_s = 20.0'
    node = LiveNode(tmp_path, sinks, source=source)
    with node, browse(f"http://127.0.0.1:{port}/") as (page, complaints):
        all_there(page)
        page.wait_for_selector("#link[data-state=live]")
        before = page.evaluate("Array.from(chachart.world.px.slice(0, 60))")
        wait(
            page,
            "before => before.filter((x, row) => Math.abs(x - chachart.world.px[row]) > 5).length > 30",
            arg=before,
        )
        assert page.evaluate("chachart.picture.drawn") > 10

        wait(page, "chachart.picture.view.auto && chachart.picture.view.scale !== 1")
        page.mouse.click(*page.evaluate(PLACE, 7))
        page.wait_for_selector("#user:not([hidden])")
        ue = page.evaluate("`${chachart.picture.ue}`")
        assert page.inner_text("#username") == f"UE {ue}"
        assert "SNR" in page.inner_text("#userfacts")
        for curve in ("#thetaplot", "#rhoplot", "#historyplot"):
            wait(
                page,
                DRAWN,
                arg=curve,
            )

        page.select_option("#theta", "music")
        page.wait_for_selector("#toast:has-text('music')")
        chosen = {"theta": "music", "rho": "bartlett"}
        until(lambda: node.ask("api/status")["method"] == chosen, "the node uses the method")
        until(lambda: node.ask("api/chart")["method"] == chosen, "the chart is made with it")
        page.select_option("#qualityof", "k")
        assert complaints == []

        node.stop(kill=True)
        page.wait_for_selector("#link[data-state=gone]")
        assert "node is gone" in page.inner_text("#gone")
        assert page.is_disabled("#theta")
        last = page.evaluate("chachart.world.newest")
        with node:
            page.wait_for_selector("#link[data-state=live]")
            wait(page, "last => chachart.world.newest > last + 1000", arg=last)
            assert page.is_hidden("#gone")
            wait(page, "document.getElementById('theta').value === 'bartlett'")
        unexpected = [text for text in complaints if "WebSocket" not in text]
        assert unexpected == []


def test_everything_works_from_the_keyboard(node: LiveNode, tmp_path: Path) -> None:
    with browse(node.address("view"), color_scheme="dark") as (page, complaints):
        all_there(page)
        press = page.keyboard.press
        press("?")
        assert "zoom in, out" in page.inner_text("#keys[open]")
        press("Escape")
        page.wait_for_selector("#keys[open]", state="detached")
        press("n")
        page.wait_for_selector("#username:has-text('UE 0')")
        press("n")
        page.wait_for_selector("#username:has-text('UE 1')")
        assert "UE 1" in page.inner_text("#said")
        press("p")
        page.wait_for_selector("#username:has-text('UE 0')")
        press("/")
        page.keyboard.type("42")
        press("Enter")
        page.wait_for_selector("#username:has-text('UE 42')")
        press("Escape")
        press("Escape")
        page.wait_for_selector("#user", state="hidden")

        view = "JSON.stringify([chachart.picture.view.centre, chachart.picture.view.scale])"
        seen = [page.evaluate(view)]
        for key in ("ArrowLeft", "ArrowUp", "+", "-", "-", "0"):
            press(key)
            seen.append(page.evaluate(view))
        assert all(a != b for a, b in pairwise(seen))
        press("t")
        assert page.input_value("#truth") == "under"
        press("c")
        assert page.input_value("#colour") == "snr"
        press("l")
        assert not page.is_checked("#trails")
        assert page.get_attribute("html", "data-theme") == "dark"
        press("d")
        assert page.get_attribute("html", "data-theme") == "light"

        press(" ")
        page.wait_for_selector("#link[data-state=paused]")
        version = page.evaluate("chachart.stream.ask('status').then(() => chachart.world.version)")
        press(" ")
        wait(page, "version => chachart.world.version > version", arg=version)

        with page.expect_download() as table:
            press("e")
        table.value.save_as(tmp_path / "chart.csv")
        with page.expect_download() as picture:
            press("s")
        picture.value.save_as(tmp_path / "chart.png")
        with page.expect_download() as drawing:
            press("g")
        drawing.value.save_as(tmp_path / "chart.svg")
        with page.expect_download() as paper:
            press("o")
        paper.value.save_as(tmp_path / "chart.pdf")
        assert complaints == []
    with (tmp_path / "chart.csv").open() as file:
        assert sorted(int(row["ue"]) for row in csv.DictReader(file)) == list(range(60))
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    circles = ElementTree.parse(tmp_path / "chart.svg").iter("{http://www.w3.org/2000/svg}circle")
    assert len(list(circles)) >= 60
    pdf = (tmp_path / "chart.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-1.4")
    start = int(pdf.split(b"startxref\n")[1].split()[0])
    places = [int(line.split()[0]) for line in pdf[start:].splitlines()[3:8]]
    assert [pdf[place:].startswith(b"%d 0 obj" % i) for i, place in enumerate(places, 1)] == [True] * 5
    assert pdf.count(b" c f\n") >= 60, "a point a UE"


def test_recording_by_hand(node: LiveNode) -> None:
    with browse(node.address("view")) as (page, complaints):
        all_there(page)
        page.click("#record")
        page.fill("#file", "page.mcap")
        page.keyboard.press("Enter")
        page.wait_for_selector("#record[aria-pressed=true]")
        page.click("#record")
        page.wait_for_selector("#record[aria-pressed=false]")
        assert complaints == []
    assert (node.folder / "page.mcap").stat().st_size > 1000


@pytest.mark.parametrize("size", [(390, 844), (844, 390)])
def test_it_fits_a_phone_and_takes_a_tap(node: LiveNode, size: tuple[int, int]) -> None:
    phone: Any = {"viewport": {"width": size[0], "height": size[1]}, "has_touch": True, "is_mobile": True}
    with browse(node.address("view"), **phone) as (
        page,
        complaints,
    ):
        all_there(page)
        wait(page, "chachart.picture.view.auto && chachart.picture.view.scale !== 1")
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        page.locator("#plot").scroll_into_view_if_needed()
        page.touchscreen.tap(*page.evaluate(PLACE, 5))
        page.wait_for_selector("#user:not([hidden])")
        assert complaints == []


def test_a_visitor_from_elsewhere_is_asked_for_the_token(node: LiveNode, token: str) -> None:
    headers = {"X-Forwarded-For": "10.0.0.7"}
    with browse(node.address("view"), extra_http_headers=headers) as (page, complaints):
        assert page.title() == "chachart: token"
        page.fill("input[name=token]", token)
        page.keyboard.press("Enter")
        all_there(page)
        assert "token" not in page.url
        assert [text for text in complaints if "401" not in text] == []


def test_names_lists_and_looking_back(tmp_path: Path) -> None:
    (tmp_path / "names.csv").write_text("7,forklift\n00:00:00:00:00:09,drone\n")
    port = free_port()
    sinks = f'[[sinks]]\ntype = "view"\nport = {port}\nnames = "names.csv"'
    node = LiveNode(tmp_path, sinks, source='motion = "waypoint"\nspeed_m_s = 20.0')
    with (
        node,
        browse(f"http://127.0.0.1:{port}/", viewport={"width": 400, "height": 800}) as (page, complaints),
    ):
        all_there(page)
        page.fill("#ue", "FORK")
        page.press("#ue", "Enter")
        page.wait_for_selector("#username:has-text('forklift · UE 7')")
        page.click("#ues")
        page.wait_for_selector("#listtable tbody tr:nth-child(60)")
        page.click("#listtable button[data-by=rho]")
        ranges = "[...document.querySelectorAll('#listtable tbody tr')].map(row => +row.cells[2].textContent)"
        found = page.evaluate(ranges)
        assert found == sorted(found)
        page.fill("#filter", "drone rho>1")
        wait(page, "document.querySelectorAll('#listtable tbody tr').length === 1")
        page.click("#listtable tbody tr")
        page.wait_for_selector("#username:has-text('drone · UE 9')")
        page.check("#follow")
        wait(
            page,
            "Math.abs(chachart.picture.view.centre[0] - chachart.world.px[chachart.world.index.get(9n)]) < 5",
        )
        page.wait_for_selector("#history:not([hidden])")
        newest = page.evaluate("chachart.world.newest")
        page.focus("#ago")
        page.keyboard.press("Home")
        page.wait_for_selector("#link:has-text('in the past')")
        wait(page, "newest => chachart.world.newest < newest", newest)
        page.click("#now")
        page.wait_for_selector("#link[data-state=live]")
        wait(page, "newest => chachart.world.newest > newest", newest)
        assert complaints == []


def test_a_plan_lies_under_the_chart(tmp_path: Path) -> None:
    picture = tmp_path / "hall.png"
    Image.new("RGB", (300, 200), "orange").save(picture)
    port = free_port()
    sinks = f'[[sinks]]\ntype = "view"\nport = {port}\nheading_deg = 45'
    with LiveNode(tmp_path, sinks), browse(f"http://127.0.0.1:{port}/") as (page, complaints):
        all_there(page)
        page.click("#plan")
        page.set_input_files("#planfile", picture)
        page.wait_for_selector("#planview:not([hidden])")
        page.click("#planview", position={"x": 10, "y": 190})
        page.click("#planview", position={"x": 290, "y": 10})
        for field, value in (("0x", "0"), ("0y", "-500"), ("1x", "600"), ("1y", "500")):
            page.fill(f"#anchor{field}", value)
        page.click("#plankeep")
        wait(page, "chachart.picture.plan.anchors !== null")
        page.reload()
        all_there(page)
        wait(page, "chachart.picture.plan.image !== null && chachart.picture.plan.anchors !== null")
        page.wait_for_timeout(300)
        orange = """() => {
            const { picture } = window.chachart;
            const pane = picture.view.panes(window.devicePixelRatio).at(-1);
            const [x, y] = [pane.x0 + 4 * pane.scale + 300 * pane.scale, pane.y0 - 3 * pane.scale];
            const seen = new Set();
            for (let dx = 0; dx < 40; dx++) {
                const [r, g, b] = picture.context.getImageData(x + dx, y, 1, 1).data;
                seen.add(r > b + 60);
            }
            return seen.has(true);
        }"""
        wait(page, f"({orange})()")
        assert [text for text in complaints if "willReadFrequently" not in text] == []


def test_why_nothing_comes_is_told_with_what_would_help(tmp_path: Path) -> None:
    port = free_port()
    more = f'[[sinks]]\ntype = "view"\nport = {port}\n[estimator]\nrho = "lr"'
    with (
        LiveNode(tmp_path, more, source="known_ues = 0"),
        browse(f"http://127.0.0.1:{port}/") as (page, complaints),
    ):
        page.wait_for_selector("#link[data-state=degraded]")
        assert "is not trained" in page.inner_text("#notice")
        assert "send known positions" in page.inner_text("#notice")
        assert "is not trained" in page.inner_text("#waiting")
        assert complaints == []


def test_distances_without_a_scale_are_no_metres(tmp_path: Path) -> None:
    port = free_port()
    sinks = f'[[sinks]]\ntype = "view"\nport = {port}'
    axes = "window.chachart?.picture.axes?.join()"
    with (
        LiveNode(tmp_path, sinks, source="known_ues = 0"),
        browse(f"http://127.0.0.1:{port}/") as (page, complaints),
    ):
        all_there(page)
        wait(page, f"{axes} === 'x, along broadside (m),y, along the array (m)'")
        page.select_option("#rho", "isq")
        wait(page, f"{axes} === 'x, along broadside (no scale),y, along the array (no scale)'")
        page.select_option("#rho", "bartlett")
        wait(page, f"{axes} === 'x, along broadside (m),y, along the array (m)'")
        assert complaints == []
