"""What one frame, one UE and one row cost on this machine: measured, a minute in all.

A node plays a recording as fast as it can, watched from outside thread by thread; state, rows, the wire, TCP
and the disk are measured by themselves.
"""

from __future__ import annotations

import tempfile
import threading
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
import zmq

from chachart.config.settings import ArraySettings
from chachart.node.commands.benchmarks import fusion
from chachart.node.commands.benchmarks.extrapolate import Costs
from chachart.node.commands.benchmarks.kernels import noisy_blocks
from chachart.node.commands.benchmarks.watched import Threads, watch
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.fusion.estimator import FusedEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options
from chachart.node.files.folders import LocalFolder
from chachart.node.net.wire import encode_chart, encode_csi
from chachart.node.runtime.processor import estimator_of
from chachart.node.runtime.table import ChartTable

BLOCK = 64
STATE_UES = 32768
"""So many that all else in the process that holds them is little."""
HOP_S = 1.0
FUSED_UES = 64
DISK_BYTES = 128 * 2**20


def measure(
    ues: int,
    seconds: float,
    method: tuple[str, str],
    footprint: Callable[[int], dict[str, float]],
    done: Callable[[int], None],
) -> tuple[Costs, Threads]:
    """All costs, and microseconds a frame by process and thread.

    Parameters
    ----------
    ues, seconds, method
        UEs, and how long each measurement takes; theta and rho.
    footprint
        Measures an estimator of so many UEs in a process of its own.
    done
        Told of each of `STEPS`.
    """
    array = ArraySettings(subcarrier_spacing_hz=312500.0).geometry()
    blocks = noisy_blocks(array, ues, BLOCK)
    with tempfile.TemporaryDirectory(prefix="chachart-bench-") as name:
        directory = Path(name)
        node = watch(directory, array, blocks, seconds, method)
        done(1)
        disk_rate = _disk(directory)
    state = footprint(STATE_UES)["state_bytes"] / STATE_UES
    done(1)
    row, chart = _rows(array, blocks[:64], method)
    plain, encrypted = (_hop(blocks[0], keys) for keys in (False, True))
    done(1)
    fuser = _fuser(seconds)
    done(1)

    costs = Costs(
        reader=node.spent("feeder", "reader"),
        dispatcher=node.spent("feeder", "main"),
        feeder_io=node.spent("feeder", "io"),
        worker=node.spent("worker"),
        collector=node.spent("main", "node"),
        publisher=node.spent("main", "sink publisher"),
        main_io=node.spent("main", "io"),
        subscriber=node.subscriber,
        fuser=fuser,
        state=state,
        row=row,
        csi=sum(len(part) for part in encode_csi(blocks[0])) / len(blocks[0]),
        chart=chart,
        tcp_rate=plain,
        curve_rate=encrypted,
        disk_rate=disk_rate,
    )
    return costs, node.threads


STEPS = 4


def _rows(array: ArrayGeometry, blocks: list[CsiBlock], method: tuple[str, str]) -> tuple[float, float]:
    """Bytes of a row in a table, and on the wire in messages of a block."""
    estimator = estimator_of(array, {"theta": method[0], "rho": method[1]}, None)
    updates = [estimator.update(block) for _ in range(2) for block in blocks][len(blocks) :]
    wire = sum(len(encode_chart(update, 0)) for update in updates) / sum(len(update) for update in updates)
    rows = ChartUpdate.concatenate(updates)
    tracemalloc.start()
    try:
        table = ChartTable(len(rows))
        table.update(rows)
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    return held / len(table), wire


def _hop(block: CsiBlock, keys: bool) -> float:
    """Frames a second from a thread to another through one TCP connection, plain or with CURVE keys."""
    message = encode_csi(block)
    with zmq.Context(2) as context, context.socket(zmq.PULL) as pull, context.socket(zmq.PUSH) as push:
        for socket in (pull, push):
            socket.set_hwm(64)
            socket.linger = 0
        if keys:
            public, secret = zmq.curve_keypair()
            pull.curve_server, pull.curve_secretkey = True, secret
            push.curve_serverkey = public
            push.curve_publickey, push.curve_secretkey = zmq.curve_keypair()
        push.connect(f"tcp://127.0.0.1:{pull.bind_to_random_port('tcp://127.0.0.1')}")
        stop = threading.Event()
        sender = threading.Thread(target=_send, args=(push, message, stop))
        sender.start()
        try:
            pull.recv_multipart(copy=False)
            begin, count = time.perf_counter(), 0
            while (seconds := time.perf_counter() - begin) < HOP_S:
                pull.recv_multipart(copy=False)
                count += len(block)
        finally:
            stop.set()
            sender.join()
    return count / seconds


def _send(push: zmq.Socket[bytes], message: list[bytes | memoryview], stop: threading.Event) -> None:
    while not stop.is_set():
        if push.poll(100, zmq.POLLOUT):
            push.send_multipart(message, copy=False)


def _disk(directory: Path) -> float:
    """Bytes a second of a file that must outlive the machine."""
    data = np.random.default_rng(0).bytes(DISK_BYTES)

    def fill(file: IO[bytes]) -> None:
        file.write(data)

    begin = time.perf_counter()
    LocalFolder(directory).write("snapshot", fill, durable=True)
    return DISK_BYTES / (time.perf_counter() - begin)


def _fuser(seconds: float) -> float:
    """Microseconds of a position from four boards round a hall, of UEs that walk."""
    boards = fusion.hall()
    area = FusionOptions(area_m=(0.0, 0.0, fusion.HALL_M, fusion.HALL_M), height_m=1.5)
    tracking = TrackingOptions.model_validate({"motion": "walk"})
    estimator = FusedEstimator(boards, area, tracking, Options(max_ues=4096))
    return 1e6 / fusion.measured(estimator, boards, FUSED_UES, seconds)[0]
