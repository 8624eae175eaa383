"""Whole nodes on simulated front-ends: the shipped loopback configurations, from packet to chart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from node_runs import Running

import chachart.config.load

RunNode = Callable[..., Running]
SHIPPED = Path(chachart.config.load.__file__).parent


def shipped(run_node: RunNode, name: str, tmp_path: Path, *changes: str) -> dict:
    """The summary of a node that runs a shipped configuration to its end."""
    changes = (f"sinks.0.endpoint=ipc://{tmp_path}/chart", *changes)
    node = run_node((SHIPPED / name).read_text(), *(word for c in changes for word in ("--set", c)))
    assert node.finish() == 0, node.said()
    assert "Traceback" not in node.said()
    return node.summary()


@pytest.mark.parametrize(("name", "frames"), [("serial-loopback.toml", 3000), ("can-loopback.toml", 150)])
def test_a_loopback_loses_nothing(run_node: RunNode, tmp_path: Path, name: str, frames: int) -> None:
    whole = ("source.loopback.drop=0.0", "source.loopback.corrupt=0.0")
    summary = shipped(run_node, name, tmp_path, f"source.loopback.scenario.frames={frames}", *whole)
    assert summary["frames_in"] == summary["frames_estimated"] == frames
    assert (summary["gaps"], summary["rejected"], summary["dropped"]) == (0, {}, {})


def test_a_loopback_with_faults_says_what_was_lost(run_node: RunNode, tmp_path: Path) -> None:
    faults = ("source.loopback.drop=0.02", "source.loopback.corrupt=0.02")
    frames = "source.loopback.scenario.frames=1500"
    summary = shipped(run_node, "serial-loopback.toml", tmp_path, frames, *faults)
    assert summary["frames_in"] == summary["frames_estimated"] < 1500
    rejected = sum(summary["rejected"].values())
    assert rejected > 0
    assert summary["frames_in"] + summary["gaps"] <= 1500 - rejected / 3, "what came damaged is no gap"
    assert summary["frames_in"] + summary["gaps"] + rejected >= 1500 - 2
    assert set(summary["rejected"]) <= {"cobs", "crc", "short"}


def test_the_chart_goes_on_after_unplugging(run_node: RunNode, tmp_path: Path) -> None:
    every = ("source.loopback.unplug_every_s=0.5", "source.loopback.unplugged_s=0.2")
    whole = ("source.loopback.drop=0.0", "source.loopback.corrupt=0.0")
    frames = "source.loopback.scenario.frames=2500"
    summary = shipped(
        run_node, "serial-loopback.toml", tmp_path, frames, *every, *whole, "source.retry_max_s=0.2"
    )
    assert summary["frames_in"] == summary["frames_estimated"]
    assert summary["gaps"] > 0
    assert summary["frames_in"] + summary["gaps"] <= 2500
    assert summary["rejected"] == {}


def test_a_port_that_is_not_there_ends_it_with_one_line(run_node: RunNode, tmp_path: Path) -> None:
    port = f"source.port={tmp_path}/nothing"
    node = run_node(
        (SHIPPED / "serial-loopback.toml").read_text(), "--set", "source.loopback=false", "--set", port
    )
    assert node.finish() == 78
    assert "there is no such device" in node.said()
    assert "Traceback" not in node.said()
