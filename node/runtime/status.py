"""The node's report about itself, and the summary it leaves behind."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field
from typing import Any

RATE_WINDOW_S = 2.0


@dataclass(slots=True)
class NodeStatus:
    """What `NodeAccess.status`, the `status.<array>` topic and the request `status` give, as plain values.

    Attributes
    ----------
    state
        `starting`, `running`, `degraded` (it runs, but something is wrong), `draining` or `stopped`.
    reason, fix
        Why it is not simply running, and what would help; None where there is nothing to say.
    stuck
        Which process has not stirred for longer than it may, or None.
    array, source, method
        Name of the array, type of the source, {theta, rho}.
    lossless
        Whether the source waits (True) or the oldest waiting block is dropped (False).
    seconds
        Since reading began.
    blocks_in
        Blocks that came from the source.
    frames_in, frames_estimated, backlog_frames
        Came in; estimated; waiting or unacknowledged. After a drain
        frames_in = frames_estimated + sum(dropped).
    frames_in_per_s, frames_estimated_per_s
        Over the last seconds.
    dropped, rejected
        Frames that were lost on the way, and input that was no usable frame, by reason.
    gaps, out_of_order
        Frames missing and frames late by the source's own numbering.
    restamped
        Live frames whose time was too far from this host's: they have this host's.
    ues, ues_evicted, ues_forgotten
        UEs on the chart, UEs that made room for others, UEs unseen for too long.
    latency_ms
        {p50, p99, p99_9} from a frame's arrival to its estimate's hand-over to the sinks, last seconds.
    latency_histogram
        {le_s, frames (cumulative), total, sum_s} since the start.
    quality
        The latest quality report, or None.
    workers
        One map each: {shard, pid, host, restarts, ues, frames_estimated, frames_replayed, backlog_frames,
        backlog_blocks, untrained}; pid is None, and there is no host, while there is no worker.
        `frames_replayed` went to a successor, `untrained` counts estimates held back until LR was trained.
    sinks
        One map each: {name, where, received, dropped, refused, errors, trouble}; refused counts peers and
        requests turned away by reason, trouble is a line of text or None.
    recording
        Where a recording that was started by request goes, or None.
    state_lost, ues_reset
        Frames that are in the estimates no more, because they had not been in a snapshot when a process died
        and could not be had again, and the UEs that they were of.
    state_error
        Why what the main process knows cannot be written to `[state] directory`, or None.
    relative
        Whether distances have no scale: rho = "isq" without a reference.
    complaint
        What was wrong with what was rejected last, or None.
    feeder_pid, feeder_restarts
        The feeder's process id, None while there is none; how often it had to be
        started again.
    antennas
        How the antennas do: `chachart.node.estimation.antennas.AntennaWatch.report`.
    source_details
        What the source tells about itself.
    sources
        Where there are several, one map each: {name (its arrays), type, pid, restarts, live, frames, quiet_s
        (since its last frame), ended, details}; pid is None while there is no process.
    alerts
        What `[[alerts]]` say: {active, counts, raised, recent, zones}, see `AlertWatch.report`.
    arrays
        Where several are fused, one map each: {name, share (of the last transmissions that it has heard),
        offset_ns (how late its clock is, None where that means nothing), offset_std_ns (deviation of that),
        drift_ns (what of it [fusion] calibration does not take off, None without one)}.
    """

    state: str = "starting"
    reason: str | None = None
    fix: str | None = None
    stuck: str | None = None
    array: str = ""
    source: str = ""
    method: dict[str, str] = field(default_factory=dict)
    lossless: bool = False
    seconds: float = 0.0
    blocks_in: int = 0
    frames_in: int = 0
    frames_estimated: int = 0
    backlog_frames: int = 0
    frames_in_per_s: float = 0.0
    frames_estimated_per_s: float = 0.0
    dropped: dict[str, int] = field(default_factory=dict)
    rejected: dict[str, int] = field(default_factory=dict)
    gaps: int = 0
    out_of_order: int = 0
    restamped: int = 0
    ues: int = 0
    ues_evicted: int = 0
    ues_forgotten: int = 0
    latency_ms: dict[str, float | None] = field(default_factory=dict)
    latency_histogram: dict[str, Any] = field(default_factory=dict)
    quality: dict[str, Any] | None = None
    workers: list[dict[str, Any]] = field(default_factory=list)
    sinks: list[dict[str, Any]] = field(default_factory=list)
    recording: str | None = None
    state_lost: int = 0
    ues_reset: int = 0
    state_error: str | None = None
    relative: bool = False
    complaint: str | None = None
    feeder_pid: int | None = None
    feeder_restarts: int = 0
    antennas: dict[str, Any] = field(default_factory=dict)
    source_details: dict[str, Any] = field(default_factory=dict)
    sources: list[dict[str, Any]] = field(default_factory=list)
    arrays: list[dict[str, Any]] = field(default_factory=list)
    alerts: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def summary(status: dict[str, Any], latency_ms: dict[str, float | None]) -> dict[str, Any]:
    """What `--summary` writes: the final status, shortened, with the whole run's latency."""
    keys = ("array", "source", "method", "frames_in", "frames_estimated", "dropped", "rejected", "gaps")
    ues = ("ues", "ues_evicted", "ues_forgotten", "ues_reset")
    return {
        **{key: status[key] for key in (*keys, "out_of_order", "restamped", *ues, "state_lost")},
        "seconds": round(status["seconds"], 3),
        "quality": status["quality"],
        "latency_ms": latency_ms,
        "worker_restarts": sum(worker["restarts"] for worker in status["workers"]),
        "feeder_restarts": status["feeder_restarts"],
        "sinks": status["sinks"],
    }


class Rates:
    """Counts per second over the last `RATE_WINDOW_S`."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, tuple[int, ...]]] = deque()

    def add(self, now: float, *counts: int) -> list[float]:
        """The counts at `now`; gives the rate of each."""
        self._samples.append((now, counts))
        while len(self._samples) > 2 and self._samples[1][0] <= now - RATE_WINDOW_S:
            self._samples.popleft()
        then, before = self._samples[0]
        return [(a - b) / (now - then) if now > then else 0.0 for a, b in zip(counts, before, strict=True)]
