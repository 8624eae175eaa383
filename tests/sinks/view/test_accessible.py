"""The page against the rules of axe-core, in both themes and with everything open."""

from __future__ import annotations

import pytest
from axe_playwright_python.sync_playwright import Axe
from browser import browse, wait
from live_node import LiveNode


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_no_rule_of_axe_is_broken(node: LiveNode, theme: str) -> None:
    with browse(node.address("view"), color_scheme=theme) as (page, complaints):
        wait(page, "window.chachart?.world.rows === 60")
        page.wait_for_selector("#antennas:not([hidden])")
        page.keyboard.press("n")
        for summary in ("#depth summary", "#response summary"):
            page.click(summary)
        page.wait_for_selector("#pathlist:has-text('path')")
        broken = [found["id"] for found in Axe().run(page).response["violations"]]
        for key, dialog in (("?", "#keys"), ("u", "#list"), ("r", "#recording")):
            page.focus("#plot")
            page.keyboard.press(key)
            page.wait_for_selector(f"{dialog}[open]")
            broken += [f"{dialog}: {found['id']}" for found in Axe().run(page).response["violations"]]
            page.keyboard.press("Escape")
            page.wait_for_selector(f"{dialog}[open]", state="detached")
        assert broken == []
        assert complaints == []
