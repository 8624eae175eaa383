"""Everything that a run found, and its plain values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.reproduction.accuracy import Accuracy
from chachart.node.commands.reproduction.paper import CITATION, Pair, published
from chachart.node.commands.reproduction.ranging import Ranged
from chachart.node.commands.reproduction.runs import Charted

WRITTEN = {"los": "LOS", "qlos": "QLOS", "qnlos": "QNLOS"}
"""Channels as people write them."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelResults:
    """What was found on one channel.

    Attributes
    ----------
    name, origin
        Which channel, and where it is from.
    truth
        True chart coordinates (U, 2).
    pairs, charted
        Pairs of methods and their charts.
    embeddings
        Charts without a model of the array.
    ranging
        Ways to range by amplitude.
    """

    name: str
    origin: str
    truth: NDArray[np.float64]
    pairs: Sequence[Pair]
    charted: Sequence[Charted]
    embeddings: Sequence[Charted]
    ranging: Sequence[Ranged]

    @property
    def k(self) -> int:
        """Neighbours of the tables."""
        return len(self.charted[0].tw)

    def table(self) -> list[dict[str, Any]]:
        """A row a pair of methods: published and measured here."""
        rows = []
        for pair, charted in zip(self.pairs, self.charted, strict=True):
            paper = published(self.name, pair)
            rows.append(
                {
                    "methods": charted.name,
                    "TW published": None if paper is None else paper.tw,
                    "TW": float(charted.tw[-1]),
                    "CT published": None if paper is None else paper.ct,
                    "CT": float(charted.ct[-1]),
                    "s published": None if paper is None else paper.seconds,
                    "s": charted.mean_seconds,
                }
            )
        return rows

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        pairs = []
        for pair, charted in zip(self.pairs, self.charted, strict=True):
            paper = published(self.name, pair)
            row = {"theta": pair[0], "rho": pair[1], **charted.as_dict()}
            pairs.append(row | {"paper": None if paper is None else paper._asdict()})
        return {
            "channel": self.name,
            "origin": self.origin,
            "k": self.k,
            "pairs": pairs,
            "embeddings": [c.as_dict() for c in self.embeddings],
            "ranging": [r.as_dict() for r in self.ranging],
        }


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All channels, the accuracy on a single path, and under which circumstances.

    Attributes
    ----------
    command
        The command line.
    settings
        What it said, with defaults.
    machine
        Where it ran.
    seconds
        How long.
    channels, accuracy
        What was found.
    """

    command: str
    settings: dict[str, Any]
    machine: dict[str, str]
    seconds: float
    channels: Sequence[ChannelResults]
    accuracy: Sequence[Accuracy]

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "command": self.command,
            "paper": CITATION,
            "settings": self.settings,
            "machine": self.machine,
            "seconds": self.seconds,
            "channels": {channel.name: channel.as_dict() for channel in self.channels},
            "accuracy": [a.as_dict() for a in self.accuracy],
        }
