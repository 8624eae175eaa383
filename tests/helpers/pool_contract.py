"""What every pool of workers does, tried out in a process of its own, since Ray leaves threads in one.

Arguments: the pool's runtime, its address. Prints what became of its workers as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import zmq
from csi_samples import small_array

from chachart.config.settings import WorkersSettings
from chachart.node.runtime import messages
from chachart.node.runtime.child import ChildProcess
from chachart.node.runtime.links import Links
from chachart.node.runtime.worker_links import Peer, WorkerLinks
from chachart.node.runtime.worker_pool import make_pool

DEADLINE_S = 60.0


class Feeder:
    """The feeder's end of a pool."""

    def __init__(self, runtime: Any, address: str) -> None:
        self._links = Links()
        settings = WorkersSettings(runtime=runtime, address=address, resources={"CPU": 0.5})
        self.pool = make_pool(settings, "lab", self._links)
        self.context = zmq.Context()
        keys = None if self.pool.keys is None else str(self.pool.keys)
        self._workers = WorkerLinks(self.context, self.pool.endpoint, keys, 1)

    def start(self, folder: str | None = None) -> ChildProcess:
        return self.pool.start(
            0,
            {
                "log_level": 20,
                "directory": str(self._links.directory),
                "workers": self.pool.endpoint,
                "array": small_array(4, 3).as_dict(),
                "shard": 0,
                "count": 1,
                "estimator": {"max_ues": 10},
                "state": {"folder": folder, "durable": False},
                "several": None,
            },
        )

    def hello(self) -> dict[str, Any]:
        """The next one that a worker says."""
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            self._workers.socket.poll(100)
            for _, kind, values, _ in self._workers.receive():
                if kind == messages.HELLO:
                    peer = Peer(values["identity"], values["pid"], values["host"], 0.0)
                    self._workers.peers[0] = peer
                    return values
        raise AssertionError("no worker said hello")

    def end(self) -> None:
        self._workers.send(0, messages.END, {})

    def close(self) -> None:
        self._workers.close()
        self.context.destroy(linger=0)
        self.pool.close()
        self._links.close()


def ended(child: ChildProcess) -> int | None:
    assert child.wait(DEADLINE_S)
    code = child.exit_code()
    child.close()
    return code


def main() -> None:
    feeder = Feeder(*sys.argv[1:])
    try:
        stranger = feeder.context.socket(zmq.DEALER)
        if feeder.pool.keys is not None:
            stranger.connect(feeder.pool.endpoint)
            hello = {"shard": 0, "pid": -1, "host": "elsewhere"}
            stranger.send_multipart([messages.HELLO, messages.pack(hello)])
        first = feeder.start()
        told = {"strangers": feeder.hello()["pid"] < 0, "while it runs": first.exit_code()}
        feeder.end()
        told["at the end"] = ended(first)
        second = feeder.start()
        feeder.hello()
        second.kill()
        told["killed"] = ended(second)
        third = feeder.start("/there/is/no/such/folder")
        told["lacking"] = ended(third)
        told["what"] = third.last_error
    finally:
        feeder.close()
    print(json.dumps(told))


if __name__ == "__main__":
    main()
