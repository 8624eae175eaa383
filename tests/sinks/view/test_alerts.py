"""Zones and alerts of a running node: at subscribers, on the page and in the metrics."""

from __future__ import annotations

from pathlib import Path

from browser import browse, wait
from live_node import LiveNode, free_port, until

from chachart.node.net.client import subscribe


def test_alerts_reach_subscribers_the_page_and_monitoring(tmp_path: Path) -> None:
    endpoint = f"tcp://127.0.0.1:{free_port()}"
    sinks = f"""
    [[zones]]
    name = "everywhere"
    circle = [0.0, 0.0, 1e5]
    [[alerts]]
    name = "arrivals"
    on = "enter"
    zone = "everywhere"
    ues = [7]
    for_s = 0.5
    [[alerts]]
    name = "poor chart"
    on = "tw"
    limit = 2.0
    [[sinks]]
    type = "view"
    port = 0
    [[sinks]]
    type = "metrics"
    port = 0
    [[sinks]]
    type = "publisher"
    endpoint = "{endpoint}"
    """
    with LiveNode(tmp_path, sinks) as node, subscribe(endpoint) as charts:

        def both() -> bool:
            charts.recv(0.1)
            return {"arrivals", "poor chart"} <= {event["alert"] for event in charts.alerts}

        until(both, "both alerts are published")
        events = {event["alert"]: event for event in charts.alerts}
        arrival = events["arrivals"]
        assert (arrival["ue"], arrival["zone"], arrival["state"]) == (7, "everywhere", "raised")
        assert arrival["text"] == "UE 7 enters everywhere"
        assert events["poor chart"]["text"].startswith("TW ")
        with browse(node.address("view")) as (page, complaints):
            page.wait_for_selector("#alerts:not([hidden])")
            wait(page, "document.querySelector('#alertsnow').innerText.includes('poor chart: TW')")
            wait(page, "document.querySelector('#alertspast').innerText.includes('UE 7 enters everywhere')")
            wait(page, "chachart.picture.zones.everywhere.length === 48")
            assert complaints == []
        _, metrics = node.get(f"{node.address('metrics')}")
        assert 'chachart_alert_active{alert="poor chart"} 1.0' in metrics
        assert 'chachart_alerts_raised_total{alert="arrivals"} 1.0' in metrics
