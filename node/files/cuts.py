"""Runs of blocks that follow each other, and parts of blocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from chachart.node.data.csi import CsiBlock


def joined(blocks: list[CsiBlock]) -> Iterator[CsiBlock]:
    """The same frames in fewer blocks: those that follow each other become one."""
    run: list[CsiBlock] = []
    for block in blocks:
        if run and not (
            block.array == run[-1].array
            and block.seq == run[-1].seq + len(run[-1])
            and (block.position is None) == (run[-1].position is None)
        ):
            yield CsiBlock.concatenate(run)
            run = []
        run.append(block)
    if run:
        yield CsiBlock.concatenate(run)


def between(block: CsiBlock, start_ns: int | None, end_ns: int | None) -> CsiBlock | None:
    """The frames of a block in a range of time; the block itself where that is all of them."""
    keep = np.ones(len(block), bool)
    if start_ns is not None:
        keep &= block.time_ns >= start_ns
    if end_ns is not None:
        keep &= block.time_ns < end_ns
    if keep.all():
        return block
    return block.take(keep) if keep.any() else None
