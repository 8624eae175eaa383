from __future__ import annotations

import argparse
from typing import Any

import pytest

from chachart.node.commands.benchmarks import costs as measuring
from chachart.node.commands.benchmarks import scale
from chachart.node.commands.benchmarks.extrapolate import Costs, Demand, ceilings, needs
from chachart.node.data.errors import SetupError

COSTS = Costs(
    reader=4,
    dispatcher=6,
    feeder_io=2,
    worker=20,
    collector=1,
    publisher=3,
    main_io=4,
    subscriber=2,
    fuser=1000,
    state=900,
    row=50,
    csi=8000,
    chart=100,
    tcp_rate=200_000,
    curve_rate=50_000,
    disk_rate=90e6,
)
"""A frame takes 40 us in all, a UE 1000 bytes."""
MACHINE = Demand(cores=8, memory_gib=8, gbit=8, load=0.5)


def test_a_node_ends_where_a_process_a_core_or_the_network_is_full() -> None:
    found = {ceiling.what: ceiling.frames for ceiling in ceilings(COSTS, MACHINE)}
    assert list(found.values()) == sorted(found.values())
    assert found["one worker"] == pytest.approx(0.5 / 20e-6)
    assert found["the 8 cores"] == pytest.approx(8 * 0.5 / 40e-6)
    assert found["feeder process (reader and dispatcher)"] == pytest.approx(0.5 / 10e-6)
    assert found["main process (collector and publisher)"] == pytest.approx(0.5 / 4e-6)
    assert found["the network that brings frames"] == pytest.approx(0.5 * 1e9 / 8000)
    assert found["a producer's connection, with keys"] == pytest.approx(25_000)
    assert found["memory"] == pytest.approx(0.8 * 2**33 / 1000)
    assert found["disk for snapshots"] == pytest.approx(90e6 * 10 / 900)


def test_who_is_seldom_heard_costs_memory_alone() -> None:
    often, seldom = (
        {one.what: one.frames for one in ceilings(COSTS, Demand.parse(f"updates={updates}", MACHINE))}
        for updates in ("1", "0.01")
    )
    assert seldom["memory"] == pytest.approx(often["memory"] / 100)
    assert seldom["one worker"] == often["one worker"]
    assert needs(COSTS, Demand.parse("ues=1e8,updates=0.001", MACHINE)).first == "memory"


def test_what_many_ues_take() -> None:
    found = needs(COSTS, Demand.parse("ues=1e6", MACHINE))
    assert (found.nodes, found.workers, found.subscribers, found.fusers) == (20, 40, 4, 0)
    assert found.machines == {"cores": 10, "memory": 1, "network": 16}
    assert (found.first, found.dearest) == ("network", "workers")
    assert (found.csi_gbit, found.chart_gbit) == pytest.approx((64.0, 0.8))
    assert (found.memory, found.snapshot) == pytest.approx((1e9, 9e8))


def test_fusing_costs_what_all_arrays_say_and_each_position() -> None:
    found = needs(COSTS, Demand.parse("ues=1e6,arrays=4", MACHINE))
    assert (found.nodes, found.workers, found.fusers) == (80, 160, 2000)
    assert found.dearest == "fusing"
    assert found.machines["cores"] == (336 + 2000) / 8


@pytest.mark.parametrize("text", ["ues", "ues=many", "uses=1", "ues=0", "ues=inf", "updates=-1", "load=2"])
def test_a_demand_that_is_none_is_told(text: str) -> None:
    with pytest.raises(SetupError, match=f"--simulate {text}: "):
        Demand.parse(text, Demand())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_it_measures_a_node_and_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"STATE_UES": 512, "DISK_BYTES": 2**20, "HOP_S": 0.1, "FUSED_UES": 4}.items():
        monkeypatch.setattr(measuring, name, value)
    monkeypatch.setattr(scale, "NODE_UES", 256)
    monkeypatch.setattr(scale, "SIZES", ((8, 8),))
    told: dict[str, Any] = {"theta": "bartlett", "rho": "isq", "max_ues": 256, "seconds": 0.3}
    by_workers, _, by_size, kept = scale.run(argparse.Namespace(simulate=None, workers=[2], **told))
    [(workers, rate, *shares, _)] = by_workers.rows
    assert workers == 2
    assert rate > 0
    assert sum(shares[:-1]) <= shares[-1] + shares[2] + 4, "parts, two workers, and what is left make all"
    assert len(by_size.rows) == 1
    assert all(isinstance(cell, int) and cell > 100 for row in kept.rows for cell in row[1:])
    tables = scale.run(argparse.Namespace(simulate=["ues=1e6", "ues=1e8,arrays=4"], **told))
    threads, costs, node, needed = tables
    measured = {row[0] for row in threads.rows}
    assert {"worker 0, main", "feeder, reader", "feeder, main", "main, node"} <= measured
    assert all(isinstance(row[1], float) and row[1] > 0 for row in (*threads.rows, *costs.rows))
    assert node.notes[0].startswith(f"breaks first: {node.rows[0][0]}")
    by_name = {row[0]: row[1:] for row in needed.rows}
    assert by_name["frames/s"] == [1_000_000, 400_000_000]
    assert by_name["processes that fuse"][0] == 0
    assert by_name["machines are bought for"][1] in ("cores", "memory", "network")
