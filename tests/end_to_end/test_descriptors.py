"""A node that has no file descriptor left: it goes on, and is whole again when there are some."""

from __future__ import annotations

import os
import resource
import signal
import socket
from contextlib import ExitStack, suppress
from pathlib import Path

from live_node import until

from chachart.node.commands.benchmarks.attack_target import Target
from chachart.node.commands.benchmarks.running import RunningNode, children


def test_a_node_without_descriptors_goes_on(tmp_path: Path) -> None:
    """Strangers use up what there is, and then a worker dies, whose successor needs some."""
    target = Target()
    with RunningNode(tmp_path, target.config()) as node, target.fed(node):
        processes = children(node.pid)
        _, hard = resource.prlimit(node.pid, resource.RLIMIT_NOFILE)
        limited = (node.pid, processes["feeder"])
        for pid in limited:
            few = len(os.listdir(f"/proc/{pid}/fd")) + 4
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (few, hard))
        with ExitStack() as held:
            for n in range(120):
                ports = target.ports
                port = (ports.source, ports.charts, ports.control, ports.web)[n % 4]
                with suppress(OSError):
                    held.enter_context(socket.create_connection(("127.0.0.1", port), 0.5))
            os.kill(processes["worker 0"], signal.SIGKILL)
            log = tmp_path / "node.log"
            until(lambda: "cannot be started now" in log.read_text(), "there is no descriptor for a worker")
        for pid in limited:
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (hard, hard))
        before = target.status()["frames_estimated"]
        until(lambda: target.status()["frames_estimated"] > before, "the node charts again")
        status = target.status()
        assert [worker["restarts"] for worker in status["workers"]] == [1]
        assert "Traceback" not in log.read_text()
        node.stop()
