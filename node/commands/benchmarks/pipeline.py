"""Pipeline: real processes and sockets, from a source to a subscriber.

Throughput plays a recording as fast as the node can, chart published and logged. Latency sends blocks from a
producer to the node's `zmq` source at a fixed rate; a subscriber compares each estimate's time, which is the
producer's at sending, with its own clock.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import msgpack
import numpy as np
import zmq
from numpy.typing import NDArray

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.running import Outcome, RunningNode
from chachart.node.commands.benchmarks.timing import Timing
from chachart.node.commands.shared.cli import progress
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.files.recording import RecordingWriter
from chachart.node.net.client import subscribe
from chachart.node.net.wire import encode_csi

SHARES = (0.1, 0.5, 0.9)
LATENCY_FRAMES = 16
"""Frames a block that the producer sends: it too must not wait long to fill one."""
LATENCY_S = 6.0
WARM_UP_S = 2.0
LISTEN_S = 0.2
LATE_S = 0.05
START_WITHIN_S = 60.0
RUN_WITHIN_S = 600.0
CAPTURE = "capture.mcap"

Seconds = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench pipeline`."""
    parser.add_argument("--ues", type=int, default=2048, help="default: %(default)s")
    parser.add_argument("--frames", type=int, default=400_000, help="frames a run (default: %(default)s)")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="default: 1 2")
    parser.add_argument("--theta", default="bartlett", choices=get_args(ThetaMethod))
    parser.add_argument("--rho", default="bartlett", choices=get_args(RhoMethod))
    parser.add_argument("--rate", type=float, nargs="*", default=[10_000.0], help="further rates for latency")
    parser.add_argument("--runs", type=int, default=3, help="timed runs (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Throughput with each number of workers, then latency at shares of the best."""
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    blocks = noisy_blocks(array, arguments.ues, 64)
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as name:
        directory = Path(name)
        throughput, best = _throughput(arguments, directory, array, blocks)
        latency = _latency(arguments, directory, blocks, best)
    return [throughput, latency]


def _throughput(
    arguments: argparse.Namespace, directory: Path, array: ArrayGeometry, blocks: list[CsiBlock]
) -> tuple[Table, float]:
    loops = record(directory, array, blocks, arguments.frames)
    table = Table(
        f"a recording at full speed, {arguments.theta} / {arguments.rho}, chart published and logged",
        ["workers", "frames", "frames/s", "MB/s", "lost", "CPU s per 1000 frames", "peak MB"],
    )
    best = 0.0
    with progress("full speed", len(arguments.workers) * arguments.runs) as done:
        for workers in arguments.workers:
            config = recording_config(directory, arguments, workers, loops)
            idle = _outcome(directory, recording_config(directory, arguments, workers, 1))
            runs = []
            for _ in range(arguments.runs):
                runs.append(_outcome(directory, config))
                done(1)
            rate = Timing.of([r.summary["frames_in"] / r.summary["seconds"] for r in runs])
            more = runs[-1].summary["frames_in"] - idle.summary["frames_in"]
            cpu = Timing.of([(r.cpu_s - idle.cpu_s) / more * 1000 for r in runs]) if more else None
            lost = sum(r.summary["frames_in"] - r.summary["frames_estimated"] for r in runs)
            frame_bytes = 8 * array.antennas * array.subcarriers
            peak = Timing.of([r.peak_bytes / 1e6 for r in runs])
            table.add(
                workers,
                runs[0].summary["frames_in"],
                rate,
                rate.median * frame_bytes / 1e6,
                lost,
                cpu,
                peak,
            )
            best = max(best, rate.median)
    table.notes = ["all processes share the machine's cores; peak memory is the sum over them"]
    return table, best


def _latency(arguments: argparse.Namespace, directory: Path, blocks: list[CsiBlock], best: float) -> Table:
    table = Table(
        f"latency from producer to subscriber, {LATENCY_FRAMES} frames a message",
        ["frames/s", "of full speed", "p50 ms", "p99 ms", "p99.9 ms", "dropped"],
    )
    rates = [share * best for share in SHARES] + list(arguments.rate)
    with progress("latency", len(rates)) as done:
        for rate in sorted(rates):
            lags, dropped = _measure_latency(arguments, directory, blocks, rate)
            p50, p99, p999 = (float(v) for v in np.percentile(lags, (50, 99, 99.9)) * 1e3)
            table.add(f"{rate:,.0f}", f"{rate / best:.0%}", p50, p99, p999, dropped)
            done(1)
    table.notes = ["producer and subscriber run on the same cores as the node"]
    return table


def _measure_latency(
    arguments: argparse.Namespace, directory: Path, blocks: list[CsiBlock], rate: float
) -> tuple[Seconds, int]:
    """Seconds from sending to receiving, one entry an estimate, and the frames that the node dropped."""
    endpoint = f"ipc://{directory}/csi"
    config = _config(directory, arguments, f'[source]\ntype = "zmq"\nendpoint = "{endpoint}"', 1)
    lags: list[Seconds] = []
    with RunningNode(directory, config) as node, zmq.Context() as context:
        push = context.socket(zmq.PUSH)
        push.sndhwm, push.linger = 4, 0
        push.connect(endpoint)
        heard, stop = threading.Event(), threading.Event()
        listener = threading.Thread(target=_listen, args=(f"ipc://{directory}/charts", heard, stop, lags))
        listener.start()
        try:
            _send(push, blocks, rate, heard)
        finally:
            stop.set()
            listener.join()
            push.close()
        outcome = node.stop()
    return np.concatenate(lags), sum(outcome.summary["dropped"].values())


def _send(push: zmq.Socket[bytes], blocks: list[CsiBlock], rate: float, heard: threading.Event) -> None:
    """Send blocks at `rate` frames/s for `WARM_UP_S` + `LATENCY_S` after the first estimate was `heard`."""
    pieces = _pieces(blocks)
    deadline = time.monotonic() + START_WITHIN_S
    while not heard.is_set() and time.monotonic() < deadline:
        push.send_multipart(next(pieces))
        heard.wait(LISTEN_S)
    start, sent = time.perf_counter(), 0
    while (now := time.perf_counter() - start) < WARM_UP_S + LATENCY_S:
        ahead = sent / rate - now
        if ahead > 0:
            time.sleep(ahead)
        elif ahead < -LATE_S:  # the node was not there yet, or full: a burst would only fill its queue
            sent = round(now * rate)
        push.send_multipart(next(pieces), copy=False)
        sent += LATENCY_FRAMES


def _pieces(blocks: list[CsiBlock]) -> Iterator[list[bytes | memoryview]]:
    """Messages of a few frames each, stamped when they are asked for."""
    encoded = []
    for block in blocks:
        for start in range(0, len(block) - LATENCY_FRAMES + 1, LATENCY_FRAMES):
            header, csi = encode_csi(block.take(np.arange(start, start + LATENCY_FRAMES)))
            encoded.append((msgpack.unpackb(header), csi))
    seq = 0
    while True:
        for header, csi in encoded:
            header["seq"] = seq
            header["time_ns"] = np.full(LATENCY_FRAMES, time.time_ns(), "<i8").tobytes()
            seq += LATENCY_FRAMES
            yield [msgpack.packb(header), csi]


def _listen(endpoint: str, heard: threading.Event, stop: threading.Event, lags: list[Seconds]) -> None:
    begin: float | None = None
    with subscribe(endpoint, timeout=LISTEN_S) as charts:
        while not stop.is_set():
            try:
                update = next(iter(charts))
            except TimeoutError:
                continue
            now = time.time_ns()
            heard.set()
            begin = begin or time.monotonic()
            if time.monotonic() - begin > WARM_UP_S:
                lags.append((now - update.time_ns) / 1e9)


def _config(directory: Path, arguments: argparse.Namespace, source: str, workers: int) -> str:
    return f"""
[array]
subcarrier_spacing_hz = 312500.0
[estimator]
theta = "{arguments.theta}"
rho = "{arguments.rho}"
[workers]
count = {workers}
[quality]
every_s = 3600
[[sinks]]
type = "publisher"
endpoint = "ipc://{directory}/charts"
[[sinks]]
type = "chart_log"
path = "{directory}/charts.mcap"
{source}
"""


def record(directory: Path, array: ArrayGeometry, blocks: list[CsiBlock], frames: int) -> int:
    """Write a recording of some rounds of `blocks`; gives how often to play it for about `frames` frames."""
    ues = sum(len(block) for block in blocks)
    rounds = max(1, min(10, frames // ues))
    with RecordingWriter(directory / CAPTURE, array) as writer:
        for n in range(rounds):
            for block in blocks:
                seq, time_ns = n * ues + block.seq, block.time_ns + n * 100_000_000
                writer.write(CsiBlock(block.array, seq, block.ue, time_ns, block.csi, block.position))
    return max(1, round(frames / (rounds * ues)))


def recording_config(directory: Path, arguments: argparse.Namespace, workers: int, loops: int) -> str:
    """A node that plays what `record` wrote as fast as it can, publishes and logs."""
    source = f'[source]\ntype = "recording"\npath = "{directory / CAPTURE}"\nspeed = 0\nloops = {loops}\n'
    return _config(directory, arguments, source, workers)


def _outcome(directory: Path, config: str) -> Outcome:
    with RunningNode(directory, config) as node:
        return node.outcome(RUN_WITHIN_S)
