"""The process that reads mutated captures: `python -m ... TASK`, a line of JSON for every so many files."""

from __future__ import annotations

import json
import resource
import signal
import sys
import tempfile
import warnings
from pathlib import Path
from types import FrameType

import numpy as np

from chachart.node.commands.benchmarks import captures, own_files
from chachart.node.commands.benchmarks.mutations import mutations
from chachart.node.data.errors import SetupError
from chachart.sources.formats import open_capture

SAMPLE_FRAMES = 3


class TooLong(BaseException):
    """A file took longer than it may; no reader catches this."""


def read(name: str, path: Path) -> bool:
    """Whether a file of that format could be opened and everything in it read."""
    try:
        if name in own_files.NAMES:
            own_files.read(name, path)
            return True
        capture = open_capture(path)
        for variable in capture.variables:
            capture.read(variable)
    except SetupError as error:
        if not str(error) or "\n" in str(error).strip():
            raise RuntimeError(f"not one clear line: {error!r}") from None
        return False
    return True


def main() -> None:
    """Read the files of the task in the first argument."""
    task = json.loads(sys.argv[1])
    limit = task["memory_mb"] << 20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("error", RuntimeWarning)

    def late(number: int, frame: FrameType | None) -> None:
        raise TooLong(f"longer than {task['seconds']} s")

    signal.signal(signal.SIGALRM, late)
    make = own_files.made if task["format"] in own_files.NAMES else captures.made
    samples = [make(task["format"], SAMPLE_FRAMES, np.random.default_rng(n)) for n in range(3)]
    samples += [Path(path).read_bytes() for path in task["samples"]]
    counts = {"read": 0, "refused": 0}
    with tempfile.TemporaryDirectory(prefix="chachart-damage-", dir=_memory()) as folder:
        path = Path(folder) / "capture"
        inputs = mutations(samples, task["seed"], task["first"], task["files"])
        for n, data in enumerate(inputs, task["first"] + 1):
            path.write_bytes(data)
            signal.setitimer(signal.ITIMER_REAL, task["seconds"])
            counts["read" if read(task["format"], path) else "refused"] += 1
            signal.setitimer(signal.ITIMER_REAL, 0)
            if n % task["report_every"] == 0 or n == task["first"] + task["files"]:
                print(json.dumps({**counts, "next": n}), flush=True)


def _memory() -> str | None:
    """A folder in memory, where there is one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


if __name__ == "__main__":
    main()
