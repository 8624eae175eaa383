"""`chachart bench truth`: its figures against what they are by definition."""

import argparse

import numpy as np
import pytest

from chachart.node.commands.benchmarks import truth
from chachart.node.commands.shared.scenes import data, pairs


def test_area_under_curve_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(0)
    score, bad = rng.standard_normal(50), rng.random(50) < 0.3
    expected = np.mean(score[bad][:, None] > score[~bad])
    assert truth.area_under_curve(score, bad) == pytest.approx(expected)
    assert np.isnan(truth.area_under_curve(score, np.zeros(50, bool)))


def test_a_row_for_each_pair_of_each_channel() -> None:
    parser = argparse.ArgumentParser()
    truth.add_arguments(parser)
    arguments = parser.parse_args(
        [
            "--channels",
            "los",
            "--seeds",
            "1",
            "--ues",
            "300",
            "--frames",
            "2",
            "--pairs",
            "joint/joint,bartlett/lr",
        ]
    )
    [table] = truth.run(arguments)
    assert [row[0] for row in table.rows] == ["Joint / Joint", "Bartlett / LR"]
    variances = [float(v) for v in table.rows[0][1].split(", ")]
    assert 0.3 < min(variances) <= max(variances) < 2
    assert float(table.rows[0][5].split(", ")[0]) < 1


@pytest.mark.parametrize("word", ["bartlett", "joint/music", "fourier/lr", "bartlett/"])
def test_what_is_no_pair_is_refused(word: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="is no pair such as"):
        pairs(word)


def test_data_names_a_channel_and_a_file() -> None:
    assert data("qlos=a.mcap")[0] == "qlos"
    for word in ("urban=a.mcap", "qlos", "qlos="):
        with pytest.raises(argparse.ArgumentTypeError, match="must look like"):
            data(word)
