"""Debian's Chromium, headless, on a node's page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from live_node import tool, until
from playwright.sync_api import Page, sync_playwright

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
DRAWN = """(id) => {
    const canvas = document.querySelector(id);
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return canvas.width > 300 && pixels.data.some(Boolean);
}"""
"""Whether something is on a canvas."""


@contextmanager
def browse(url: str, **context: Any) -> Iterator[tuple[Page, list[str]]]:
    """The node's page with its chart on it, and what the console complains about."""
    chromium = tool("chromium", "chromium")
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        page = browser.new_page(**context)
        page.set_default_timeout(30_000)
        page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url)
        yield page, complaints
        browser.close()


def wait(page: Page, expression: str, arg: Any = None) -> None:
    """Until an expression, or a function of `arg`, is true; the page's policy forbids to poll in the page."""
    until(lambda: page.evaluate(expression, arg) or page.wait_for_timeout(30), expression)
