from __future__ import annotations

import argparse

import pytest

from chachart.node.commands.benchmarks import attack, attack_worker
from chachart.node.commands.benchmarks.attack_floods import FLOODS, MUTATED
from chachart.node.commands.benchmarks.attack_inputs import DECODERS, Decoder
from chachart.node.commands.benchmarks.attack_worker import throw
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.data.errors import SetupError


def arguments(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    attack.add_arguments(parser)
    return parser.parse_args(words)


def test_mutated_inputs_give_a_value_or_a_clean_error() -> None:
    [table] = attack.run(arguments("--inputs", "2000", "--no-floods", "--seed", "1"))
    rows = table.as_dict()["rows"]
    assert [row["decoder"] for row in rows] == list(DECODERS)
    for row in rows:
        assert row["taken"] + row["refused"] == 2000
        assert row["refused"] or row["decoder"] == "stream", "mutations are felt"


def test_samples_as_they_are_are_taken() -> None:
    for make in DECODERS.values():
        decoder = make()
        for sample in decoder.samples:
            decoder.decode(sample)


def test_anything_else_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DECODERS, "csi", lambda: Decoder([b"abc"], lambda data: 1 / 0, (ValueError,)))
    with pytest.raises(SetupError, match=r"csi, input 1000 of seed 0: ZeroDivisionError"):
        throw("csi", 0, 1000, 5)


def test_a_decoder_that_is_stuck_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attack_worker, "LONGEST_S", 0.2)
    monkeypatch.setitem(DECODERS, "csi", lambda: Decoder([b"abc"], lambda data: forever(), ()))
    with pytest.raises(SetupError, match=r"csi, input 0 of seed 0: Stuck"):
        throw("csi", 0, 0, 5)


def forever() -> None:
    while True:
        pass


def test_inputs_are_the_same_for_the_same_seed_wherever_one_begins() -> None:
    samples = [b"a" * 50, b"b" * 70]
    all_of_them = list(mutations(samples, 3, 0, 2500))
    assert list(mutations(samples, 3, 1000, 1500)) == all_of_them[1000:]
    assert list(mutations(samples, 4, 0, 2500)) != all_of_them
    assert len(set(all_of_them)) > 1500


@pytest.mark.timeout(600)
def test_a_node_charts_through_every_flood() -> None:
    """It lives (or the command fails), its memory is bounded, and what is turned away is told."""
    table, lines = attack.run(arguments("--inputs", "0", "--seconds", "1", "--thrown", "300"))
    rows = {row["flood"]: row for row in table.as_dict()["rows"]}
    assert rows.keys() == {"none", *FLOODS}
    for name, row in rows.items():
        assert row["MB more at most"] < 500, name
        assert row["thrown"] == 300 or name not in MUTATED, name
    assert rows["connections"]["thrown"] > 0
    for row in lines.as_dict()["rows"]:
        assert row["of these charted"] == row["good among them"] == 6, row["line"]
    assert sum(row["turned away"] for row in rows.values()) > 0
