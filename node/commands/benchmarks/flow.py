"""Flow: recordings, the wire and the sinks by themselves, without a node around them."""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from isal.isal_zlib import crc32

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks.report import Table
from chachart.node.commands.benchmarks.timing import Timing, time_in_turn
from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.columns import COLUMNS
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.recording import RecordingReader, RecordingWriter
from chachart.node.net.wire import decode_chart, decode_csi, encode_chart, encode_csi
from chachart.sinks.chart_log import ChartLog, ChartLogSettings
from chachart.sinks.publisher import ROWS_PER_MESSAGE
from chachart.sources.base import EndOfSource
from chachart.sources.recording import Recording, RecordingSettings
from chachart.sources.zmq import ZmqSettings, ZmqSource

BLOCK_FRAMES = (64, 1)
CHART_UES = (2048, 100_000)
RUNS = 5
REPEATS = 1000
"""What takes microseconds is timed so many times in one go."""

Call = Callable[[], Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `chachart bench flow`."""
    parser.add_argument(
        "--frames", type=int, default=12_800, help="frames of each recording (default: %(default)s)"
    )
    parser.add_argument("--runs", type=int, default=RUNS, help="repetitions (default: %(default)s)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Measure recordings, the wire and charts in turn."""
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as folder:
        return [
            _recordings(Path(folder), array, arguments.frames, arguments.runs),
            _wire(Path(folder), array, arguments.frames, arguments.runs),
            _charts(Path(folder), array, arguments.runs),
        ]


def _recordings(folder: Path, array: ArrayGeometry, frames: int, runs: int) -> Table:
    table = Table(
        f"recordings, {frames} frames of {array.antennas} x {array.subcarriers}, frames/s",
        ["frames a block", "write", "read", "as a source", "seek to the middle, ms"],
    )
    for k in BLOCK_FRAMES:
        blocks = list(_blocks(array, frames, k))
        path = folder / f"{k}.mcap"
        calls: dict[str, Call] = {
            "write": partial(_write, path, array, blocks),
            "read": partial(_read, path),
            "source": partial(_play, path, array),
            "seek": partial(_seek, path, int(blocks[len(blocks) // 2].time_ns[0])),
        }
        timings = time_in_turn(calls, runs=runs)
        rates = [_rate(timings[name], frames) for name in ("write", "read", "source")]
        table.add(k, *rates, timings["seek"].scaled(1e3))
    data = bytes(blocks[0].csi.nbytes)
    shares = {"crc": _repeated(partial(crc32, data)), "copy": _repeated(partial(bytearray, data))}
    crc, copy = (timing.scaled(1e6 / REPEATS) for timing in time_in_turn(shares, runs=runs).values())
    table.notes = [f"of reading, the CRC-32 takes {crc} us a frame; copying a frame once takes {copy} us"]
    return table


def _wire(folder: Path, array: ArrayGeometry, frames: int, runs: int) -> Table:
    table = Table(
        "CSI over ZeroMQ",
        ["frames a block", "encode, us a block", "decode, us a block", "zmq source, frames/s"],
    )
    for k in BLOCK_FRAMES:
        block = next(_blocks(array, k, k))
        parts = encode_csi(block)
        count = max(frames // k, 1)
        received = [_receive(folder, array, k, count) for _ in range(runs)]
        calls = {
            "encode": _repeated(partial(encode_csi, block)),
            "decode": _repeated(partial(decode_csi, parts)),
        }
        timings = time_in_turn(calls, runs=runs).values()
        table.add(k, *(t.scaled(1e6 / REPEATS) for t in timings), _rate(Timing.of(received), count * k))
    table.notes = ["the producer is a thread of the same process and shares its interpreter"]
    return table


def _charts(folder: Path, array: ArrayGeometry, runs: int) -> Table:
    table = Table("charts, ms for all UEs", ["UEs", "encode", "decode", "log as JSON", "log as msgpack"])
    for ues in CHART_UES:
        chart = _chart(ues)
        bodies = _encode_chart(chart)
        calls: dict[str, Call] = {
            "encode": partial(_encode_chart, chart),
            "decode": partial(_decode_chart, bodies),
        }
        logs = []
        for encoding in ("json", "msgpack"):
            path = folder / f"{ues}-{encoding}.mcap"
            settings = ChartLogSettings.model_validate({"path": path, "encoding": encoding, "every_s": 0})
            log = ChartLog(settings, array)
            log.open(None)
            logs.append(log)
            calls[encoding] = partial(log.on_chart, chart)
        timings = time_in_turn(calls, runs=runs)
        for log in logs:
            log.close()
        table.add(ues, *(timing.scaled(1e3) for timing in timings.values()))
    return table


def _blocks(array: ArrayGeometry, frames: int, k: int) -> Iterator[CsiBlock]:
    """Noise of many UEs, 100 us apart, in blocks of `k`."""
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((max(k, 64), array.antennas, array.subcarriers, 2), np.float32)
    csi = samples.view(np.complex64)[..., 0]
    for seq in range(0, frames - k + 1, k):
        ue = np.arange(seq, seq + k, dtype=np.uint64)
        start = seq % (len(csi) - k + 1)
        yield CsiBlock(array.name, seq, ue, 100_000 * ue.astype(np.int64), csi[start : start + k])


def _repeated(call: Call) -> Call:
    def calls() -> None:
        for _ in range(REPEATS):
            call()

    return calls


def _write(path: Path, array: ArrayGeometry, blocks: list[CsiBlock]) -> None:
    path.unlink(missing_ok=True)
    with RecordingWriter(path, array) as writer:
        for block in blocks:
            writer.write(block)


def _read(path: Path) -> int:
    return sum(len(block) for block in RecordingReader(path).blocks())


def _seek(path: Path, start_ns: int) -> CsiBlock:
    return next(RecordingReader(path).blocks(start_ns=start_ns))


def _play(path: Path, array: ArrayGeometry) -> None:
    with Recording(RecordingSettings(path=path, speed=0), array) as source:
        try:
            while True:
                source.recv(1.0)
        except EndOfSource:
            return


def _receive(folder: Path, array: ArrayGeometry, k: int, count: int) -> float:
    """Seconds that `count` blocks take from a producer's thread to the source."""
    endpoint = f"ipc://{folder}/csi"
    messages = [encode_csi(block) for block in _blocks(array, count * k, k)]
    with (
        ZmqSource(ZmqSettings(endpoint=endpoint, lossless=True), array) as source,
        zmq.Context() as context,
        context.socket(zmq.PUSH) as socket,
    ):
        socket.sndhwm = 16
        socket.connect(endpoint)

        def produce() -> None:
            for message in messages:
                socket.send_multipart(message, copy=False)

        producer = threading.Thread(target=produce)
        begin = time.perf_counter()
        producer.start()
        missing = count * k
        while missing > 0:
            missing -= len(source.recv(1.0) or ())
        seconds = time.perf_counter() - begin
        producer.join()
    return seconds


def _encode_chart(chart: ChartUpdate) -> list[bytes]:
    return [encode_chart(part, 0) for part in chart.parts(ROWS_PER_MESSAGE)]


def _decode_chart(bodies: list[bytes]) -> list[tuple[int, ChartUpdate]]:
    return [decode_chart(body) for body in bodies]


def _chart(ues: int) -> ChartUpdate:
    rng = np.random.default_rng(2)
    columns: dict[str, Any] = {
        column.name: rng.uniform(0.1, 3.0, ues)
        for column in COLUMNS.values()
        if column.dtype == "float64" and column.shape(ues) == (ues,)
    }
    ue = np.arange(ues, dtype=np.uint64)
    return ChartUpdate("lab", Method("bartlett", "bartlett"), ue, 100_000 * ue.astype(np.int64), **columns)


def _rate(timing: Timing, frames: int) -> str:
    """Frames a second: the median, and from the slowest run to the fastest."""
    return f"{frames / timing.median:,.0f} ({frames / timing.most:,.0f}..{frames / timing.least:,.0f})"
