"""Command line words for scenes: channels, pairs of methods, recordings instead of a model's draws."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final, get_args

from chachart.node.data.methods import RhoMethod, ThetaMethod

CHANNELS: Final = ("los", "qlos", "qnlos")


def pairs(text: str) -> tuple[tuple[str, str], ...]:
    """Pairs such as `bartlett/music,joint/joint`, each once.

    Raises
    ------
    argparse.ArgumentTypeError
        If a word is none.
    """
    found = []
    for word in text.lower().split(","):
        theta, _, rho = word.partition("/")
        known = theta in get_args(ThetaMethod) and rho in get_args(RhoMethod)
        if not known or ((theta == "joint") != (rho == "joint") and rho != "auto"):
            raise argparse.ArgumentTypeError(f'"{word}" is no pair such as bartlett/music or joint/joint')
        found.append((theta, rho))
    return tuple(dict.fromkeys(found))


def data(text: str) -> tuple[str, Path]:
    """`CHANNEL=FILE`.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is not.
    """
    name, _, path = text.partition("=")
    if name not in CHANNELS or not path:
        raise argparse.ArgumentTypeError(f'"{text}" must look like qnlos=FILE.mcap')
    return name, Path(path)
