from __future__ import annotations

import argparse

import pytest

from chachart.node.commands.benchmarks import attack
from chachart.node.commands.benchmarks.attack_floods import FLOODS
from chachart.node.commands.benchmarks.attack_inputs import DECODERS, Decoder
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
    with pytest.raises(SetupError, match=r"csi, input 0 of seed 0: ZeroDivisionError"):
        attack.run(arguments("--inputs", "5", "--decoder", "csi", "--no-floods"))


@pytest.mark.timeout(300)
def test_a_node_charts_through_every_flood() -> None:
    """A second of each: the node lives, its memory is bounded, and what is turned away is told."""
    [table] = attack.run(arguments("--inputs", "0", "--seconds", "1"))
    rows = {row["flood"]: row for row in table.as_dict()["rows"]}
    assert rows.keys() == {"none", *FLOODS}
    for name, row in rows.items():
        assert row["estimates/s"] > 0, name
        assert row["MB more"] < 500, name
        assert row["thrown"] > 0 or name == "none"
    for name in ("subscriptions", "producers", "messages"):
        assert rows[name]["turned away"] > 0, name
