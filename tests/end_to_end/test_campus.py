"""The shipped campus, a process each: two sites and what fuses them, and a site that dies and comes back."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from node_runs import DEADLINE_S, Running, until

from chachart.config import shipped
from chachart.node.commands.ctl import ask

UES = 8
FEWER = (f"source.ues={UES}", "source.frame_rate_hz=32")
SITES = ("north", "west")


def test_two_sites_are_one_chart_whoever_dies_and_comes_back(
    run_node: Callable[..., Running], tmp_path: Path
) -> None:
    def start(name: str, *changes: str) -> Running:
        at = f"ipc://{tmp_path}/{name}"
        own = (f"sinks.publisher.endpoint={at}", f"sinks.control.endpoint={at}-control", "sinks.view.port=0")
        told = [word for change in (*own, *changes) for word in ("--set", change)]
        return run_node(shipped.text_file(name).read_text(), *told)

    def fused(operation: str) -> dict[str, Any]:
        return ask(f"ipc://{tmp_path}/campus-control", {"op": operation}, DEADLINE_S)

    def right(arrays: int, since_ns: int = 0) -> bool:
        """Whether all UEs have been fused since then, most of so many arrays and where they are."""
        chart = fused("chart")
        if len(chart.get("ue", ())) < UES or min(chart["time_ns"]) <= since_ns:
            return False
        error = np.subtract([chart["x"], chart["y"]], np.transpose(chart["position"])[:2])
        good = (np.array(chart["arrays"]) == arrays) & (np.hypot(*error) < 2.0)
        return bool(good.mean() > 0.8)

    sources = [f"source.{n}.endpoint=ipc://{tmp_path}/campus-{name}" for n, name in enumerate(SITES)]
    campus = start("campus", *sources)
    sites = {name: start(f"campus-{name}", *FEWER) for name in SITES}
    until(lambda: right(2), "both sites are heard")

    sites["west"].signal(signal.SIGKILL)
    sites["west"].finish()
    until(lambda: "array west: nothing for" in (fused("status").get("reason") or ""), "its silence is told")
    newest = max(fused("chart")["time_ns"])
    until(lambda: min(fused("chart")["time_ns"]) > newest, "north goes on alone")

    sites["west"] = start("campus-west", *FEWER)
    until(lambda: right(2, newest), "both are heard again")
    for node in (campus, *sites.values()):
        node.signal(signal.SIGTERM)
    assert [node.finish() for node in (campus, *sites.values())] == [0, 0, 0]
    assert campus.summary()["worker_restarts"] == 0
