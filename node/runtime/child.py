"""How the node's child processes start and end.

A child is a plain `python -P -m` process, never forked, and no file in the directory where the node was
started takes the place of a library. Its settings come as one line of JSON on stdin, its log records go out
as lines of JSON on stderr. It is out of reach of the terminal's signals (a group of its own, SIGINT and
SIGTERM ignored) and obeys the main process; when stdin ends, that is dead and the child goes too.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
from typing import Any, Protocol

log = logging.getLogger(__name__)

NICENESS = 15
PR_SET_PDEATHSIG = 1
"""Of prctl(2)."""
LACKS = 74
"""Exit status (EX_IOERR) of a child that lacks something outside; its last error says what."""
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"), "1"
)
"""BLAS must not fight the workers for the cores; these count only when set before numpy is loaded."""
KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": str(128 * 2**20), "MALLOC_MMAP_THRESHOLD_": str(32 * 2**20)}
"""What a block took, the next one takes again: glibc would give it back, and the system clear it anew."""


class ChildProcess(Protocol):
    """A running child process, on this machine (`Child`) or another; see there."""

    name: str
    pid: int
    last_error: str | None

    def exit_code(self) -> int | None: ...

    def wait(self, timeout: float | None = None) -> bool: ...

    def kill(self) -> None: ...

    def close(self, timeout: float = 1.0) -> None: ...


class Child:
    """A running child process.

    Parameters
    ----------
    name
        What the log calls it.
    module
        What to run.
    settings
        Plain values for `read_settings`; `log_level` and `directory` (of the sockets; None: it has none) are
        among them.

    Attributes
    ----------
    pid
        Its process id.
    last_error
        The last error that it logged, or None.
    """

    def __init__(self, name: str, module: str, settings: dict[str, Any]) -> None:
        self.name = name
        self.last_error: str | None = None
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env={**KEEP_MEMORY, **os.environ, **ONE_THREAD},
            process_group=0,
        )
        self.pid = self._process.pid
        self._reader = threading.Thread(target=self._relay_log, name=f"{name} log", daemon=True)
        self._reader.start()
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(settings).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            log.error("%s ended before it had its settings", name)

    def exit_code(self) -> int | None:
        """None while it runs; minus the signal's number where one killed it."""
        return self._process.poll()

    def wait(self, timeout: float | None = None) -> bool:
        """Whether it has ended within `timeout` seconds; None: however long that takes."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def yield_to_others(self) -> None:
        """Run it at low priority from now on, even where the node was given real-time priority."""
        with contextlib.suppress(ProcessLookupError):
            os.sched_setscheduler(self.pid, os.SCHED_BATCH, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, self.pid, NICENESS)

    def kill(self) -> None:
        """End it now."""
        self._process.kill()

    def close(self, timeout: float = 1.0) -> None:
        """Make sure that it has ended (killed after `timeout` seconds), and let go of its pipes."""
        if not self.wait(timeout):
            self.kill()
            self._process.wait()
        self._reader.join(timeout=1.0)
        for pipe in (self._process.stdin, self._process.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):  # it ended before it had read its settings
                    pipe.close()

    def _relay_log(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            text = line.decode(errors="replace").rstrip()
            try:
                level, logger, message = json.loads(text)
            except (ValueError, TypeError):
                level, logger, message = logging.ERROR, __name__, text
            if level >= logging.ERROR:
                self.last_error = message
            logging.getLogger(logger).log(level, "%s: %s", self.name, message)


def read_settings() -> dict[str, Any]:
    """In a child: take up the settings, ignore signals to end, follow the main process in death."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    settings: dict[str, Any] = json.loads(sys.stdin.buffer.readline())
    handler = _JsonLines()
    handler.setFormatter(logging.Formatter("%(message)s"))
    logging.basicConfig(level=settings["log_level"], handlers=[handler])
    follow = threading.Thread(
        target=_follow_parent, args=(settings["directory"],), name="parent watch", daemon=True
    )
    follow.start()
    if settings["directory"] is None:
        _end_with_parent()
    return settings


def leave_alone_what_lives() -> None:
    """Once everything is loaded: what lives now lives on, and Python need not look through it for garbage.

    A look through all the objects of a process takes 20 ms and more, and comes in the middle of a block.
    """
    gc.collect()
    gc.freeze()


def class_path(cls: type) -> str:
    """How a child finds a class again: `module:name`."""
    return f"{cls.__module__}:{cls.__qualname__}"


def load_class(path: str) -> Any:
    """The class that `class_path` named."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def _follow_parent(directory: str | None) -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    if directory is not None:
        shutil.rmtree(directory, ignore_errors=True)
    os._exit(1)


def _end_with_parent() -> None:
    """Have the kernel kill this process with the thread that started it, even while this one is stopped."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class _JsonLines(logging.Handler):
    """Log records as [level, logger, message] on stderr, for `Child` to read."""

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(json.dumps([record.levelno, record.name, self.format(record)]) + "\n")
        sys.stderr.flush()
