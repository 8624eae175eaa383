from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from chachart.node.commands.benchmarks import captures, damage, formats
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture


def arguments(module: object, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)  # type: ignore[attr-defined]
    return parser.parse_args(words)


@pytest.mark.parametrize("name", damage.NAMES)
def test_mutated_files_give_what_is_whole_or_a_clean_error(name: str) -> None:
    [table] = damage.run(arguments(damage, "--files", "60", "--format", name))
    [row] = table.as_dict()["rows"]
    assert (row["files"], row["read"] + row["refused"], row["faults"]) == (60, 60, 0)


def test_a_reader_that_does_not_get_by_is_a_fault() -> None:
    with pytest.raises(SetupError, match=r"npy: file 7 ended the reader \(--first 7 --files 1\)"):
        damage.run(arguments(damage, "--files", "5", "--first", "7", "--format", "npy", "--memory-mb", "16"))


def test_samples_of_ones_own_are_mutated_too(tmp_path: Path) -> None:
    sample = tmp_path / "sample.dat"
    sample.write_bytes(captures.made("intel5300", 3, np.random.default_rng(2)))
    words = ["--files", "8", "--format", "intel5300", "--sample", str(sample)]
    [table] = damage.run(arguments(damage, *words))
    assert table.rows[0][1] == 8


def test_mutations_are_the_same_for_the_same_seed() -> None:
    data = captures.made("feitcsi", 2, np.random.default_rng(2))
    first, again, other = (list(mutations([data], seed, 998, 4)) for seed in (1, 1, 2))
    assert first == again
    assert first[1:3] == list(mutations([data], 1, 999, 2))
    assert first != other


@pytest.mark.parametrize("name", captures.NAMES)
def test_made_up_captures_are_whole(tmp_path: Path, name: str) -> None:
    path = tmp_path / "capture"
    path.write_bytes(captures.made(name, 5, np.random.default_rng(2)))
    capture = open_capture(path)
    assert not capture.left_out
    assert {variable.shape[0] for variable in capture.variables.values() if variable.shape} == {5}


def test_the_speed_of_each_format(tmp_path: Path) -> None:
    [table] = formats.run(arguments(formats, "--megabytes", "1", "--runs", "1"))
    assert [row[0] for row in table.rows] == list(formats.WIFI)
    path = tmp_path / "own.dat"
    path.write_bytes(captures.made("atheros", 5, np.random.default_rng(2)))
    [table] = formats.run(arguments(formats, str(path), "--runs", "1"))
    assert table.rows[0][:3] == ["own.dat", path.stat().st_size / 1e6, 5]
