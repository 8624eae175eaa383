from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from csi_samples import small_array, some_block

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError
from chachart.node.runtime.processor import BlockProcessor, FrameClock

ARRAY = small_array(8, 4)
BARTLETT = ("bartlett", "bartlett")


def processor(live: bool = False, monotonic: Any = lambda: 0.0, **estimator: Any) -> BlockProcessor:
    return BlockProcessor(ARRAY, estimator, FrameClock(live, monotonic))


def block(frames: int = 6, **arguments: Any) -> CsiBlock:
    return some_block(frames, antennas=8, subcarriers=4, **arguments)


def test_one_row_for_each_ue() -> None:
    frames = block()
    outcome = processor().process(frames, *BARTLETT)
    assert outcome.update is not None
    assert sorted(outcome.update.ue.tolist()) == sorted(set(frames.ue.tolist()))
    assert (outcome.estimated, outcome.dropped) == (6, {})


def test_frames_that_cannot_be_used_are_dropped_and_counted_per_block() -> None:
    worker = processor()
    frames = block()
    frames.csi[1], frames.csi[2] = np.nan, 0
    outcome = worker.process(frames, *BARTLETT)
    assert (outcome.estimated, outcome.dropped) == (4, {"not_finite": 1, "zero": 1})
    assert worker.process(block(seq=6), *BARTLETT).dropped == {}


def test_a_block_without_a_usable_frame_gives_no_update() -> None:
    frames = block(3)
    frames.csi[:] = np.inf
    outcome = processor().process(frames, *BARTLETT)
    assert (outcome.update, outcome.estimated, outcome.dropped) == (None, 0, {"not_finite": 3})


def test_a_block_that_the_estimator_refuses_is_counted(caplog: pytest.LogCaptureFixture) -> None:
    frames = block()
    object.__setattr__(frames, "time_ns", frames.time_ns[:3])  # what no decoder lets through
    outcome = processor().process(frames, *BARTLETT)
    assert (outcome.update, outcome.estimated, outcome.dropped) == (None, 0, {"estimation_failed": 6})
    assert "6 frames could not be estimated" in caplog.text


def test_a_frame_of_a_failed_block_is_counted_once() -> None:
    worker = processor()
    frames = block()
    frames.csi[1] = 0
    object.__setattr__(frames, "time_ns", frames.time_ns[:3])
    outcome = worker.process(frames, *BARTLETT)
    assert (outcome.estimated, outcome.dropped) == (0, {"zero": 1, "estimation_failed": 5})
    outcome = worker.process(block(seq=6), *BARTLETT)
    assert (outcome.estimated, outcome.dropped) == (6, {})


def test_frames_without_an_estimate_are_not_estimated() -> None:
    worker = processor(theta="mvdr", rho="bartlett", loading=0.0)  # 4 snapshots a frame for 8 x 8
    frames = block()
    ues = np.arange(6) // 3
    frames.ue[:] = ues
    outcome = worker.process(frames.take(ues == 0), "mvdr", "bartlett")
    assert (outcome.estimated, outcome.dropped) == (3, {})
    outcome = worker.process(frames.take(np.array([0, 3])), "mvdr", "bartlett")
    assert outcome.update is not None
    assert outcome.update.ue.tolist() == [0]
    assert (outcome.estimated, outcome.dropped) == (1, {"no_estimate": 1})


def test_untrained_rows_are_no_lost_frames(caplog: pytest.LogCaptureFixture) -> None:
    worker = processor(rho="lr")
    outcome = worker.process(block(position=False), "bartlett", "lr")
    assert (outcome.update, outcome.estimated, outcome.dropped) == (None, 6, {})
    assert worker.untrained > 0
    worker.process(block(position=False, seq=6), "bartlett", "lr")
    assert [record.message for record in caplog.records] == [
        'rho = "lr" keeps UEs off the chart until it has seen two with a known position'
    ]


def test_recordings_forget_by_frame_time() -> None:
    worker = processor(forget_after_s=10.0)
    worker.process(block(start_ns=0), *BARTLETT)
    before = worker.ues
    worker.forget()
    assert worker.ues == before
    worker.process(block(1, seq=7, start_ns=20_000_000_000), *BARTLETT)
    worker.forget()
    assert worker.ues == 1


def test_live_sources_forget_while_nothing_comes() -> None:
    now = [100.0]
    worker = processor(live=True, monotonic=lambda: now[0], forget_after_s=10.0)
    worker.process(block(start_ns=0), *BARTLETT)
    worker.forget()
    assert worker.ues > 0
    now[0] += 11.0
    worker.forget()
    assert worker.ues == 0


def test_spectrum_is_plain_values() -> None:
    worker = processor()
    frames = block()
    worker.process(frames, *BARTLETT)
    answer = worker.spectrum(int(frames.ue[0]))
    assert isinstance(answer["theta_spectrum"], list)
    assert isinstance(answer["theta"], float)


def test_a_ue_that_is_not_there_has_no_spectrum() -> None:
    worker = processor()
    worker.process(block(), *BARTLETT)
    with pytest.raises(RequestError, match="UE 5000 is not on the chart"):
        worker.spectrum(5000)


def test_methods_that_do_not_fit_change_nothing() -> None:
    worker = processor()
    frames = block()
    worker.process(frames, *BARTLETT)
    with pytest.raises(ValueError, match="theta"):
        worker.set_method("bartlet", "music")
    update = worker.process(frames, *BARTLETT).update
    assert update is not None
    assert update.method.theta == "bartlett"
    assert (update.snapshots > 1.9).all()


def test_every_block_is_estimated_with_its_own_methods() -> None:
    worker = processor()
    worker.process(block(), *BARTLETT)
    update = worker.process(block(seq=6), "music", "isq").update
    assert update is not None
    assert (update.method.theta, update.method.rho) == ("music", "isq")
