"""A real node as a process of its own, with the simulator before it and web sinks behind it."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

DEADLINE_S = 60.0
_PORTS = count(97 * os.getpid())
_TIMER = threading.Event()


def until(condition: Callable[[], Any], what: str) -> Any:
    """Wait for a condition, not for a time; its value."""
    deadline = time.monotonic() + DEADLINE_S
    while not (value := condition()):
        assert time.monotonic() < deadline, f"never happened: {what}"
        _TIMER.wait(0.05)
    return value


def tool(name: str, package: str) -> str:
    """Where a program is; the test is skipped where it is not, but fails where CHACHART_CI is set."""
    found = shutil.which(name)
    if found is None:
        reason = f"{name} is not installed (Debian's package {package})"
        if os.environ.get("CHACHART_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


def free_port() -> int:
    """A port that nobody listens on right now, and that the system gives nobody who asks for any."""
    while True:
        port = 10_000 + next(_PORTS) % 20_000
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def other_address() -> str | None:
    """An address of this machine that is not loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return None
        address: str = probe.getsockname()[0]
        return address


class LiveNode:
    """`chachart-node` on a small simulated world; its sinks are given as TOML."""

    def __init__(self, folder: Path, sinks: str, ues: int = 60, source: str = "") -> None:
        self.folder = folder
        self._config = folder / "node.toml"
        self._log = folder / "node.log"
        self._config.write_text(
            f"""
            [array]
            antennas = 8
            subcarriers = 8
            subcarrier_spacing_hz = 312500.0
            height_m = 8.5
            [source]
            type = "simulator"
            layout = "uniform"
            ues = {ues}
            frame_rate_hz = 600.0
            snr_db = 20.0
            {source}
            [quality]
            every_s = 0.5
            {sinks}
            """
        )
        self._arguments = ["--config", str(self._config)]
        self._process: subprocess.Popen[bytes] | None = None

    @classmethod
    def told(cls, folder: Path, *arguments: str) -> Self:
        """A node with these arguments instead of a configuration."""
        node = cls(folder, "")
        node._arguments = list(arguments)
        return node

    def start(self) -> Self:
        """Start the process and wait until it runs."""
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "chachart.node.commands.node", *self._arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=self.folder,
                env={**os.environ, "TMPDIR": str(self.folder), "PYTHONWARNINGS": "error"},
            )
        until(lambda: "frames are read" in self.said() or self._ended(), "the node runs")
        assert not self._ended(), self.said()
        return self

    def stop(self, *, kill: bool = False) -> int:
        """End the process, gracefully or not; its exit status."""
        assert self._process is not None
        if kill:
            self._process.kill()
        else:
            self._process.terminate()
        return self._process.wait(DEADLINE_S)

    @property
    def pid(self) -> int:
        """The node's main process."""
        assert self._process is not None
        return self._process.pid

    def said(self) -> str:
        """The log so far."""
        return self._log.read_text()

    def address(self, sink: str) -> str:
        """Where a sink said that it is."""
        match = until(lambda: re.search(rf"\b{sink}: (\S+)", self.said()), f"{sink} has an address")
        address: str = match[1]
        return address

    def get(self, url: str, method: str = "GET", headers: dict[str, str] | None = None) -> tuple[int, str]:
        """HTTP status and body."""
        request = urllib.request.Request(url, method=method, headers=headers or {})
        try:
            with urllib.request.urlopen(request, timeout=DEADLINE_S) as response:
                return response.status, response.read().decode()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode()

    def ask(self, path: str, method: str = "GET") -> dict[str, Any]:
        """What the view's HTTP interface answers."""
        status, body = self.get(self.address("view") + path, method)
        assert status == 200, body
        answer: dict[str, Any] = json.loads(body)
        return answer

    def _ended(self) -> bool:
        return self._process is not None and self._process.poll() is not None

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._ended():
            self.stop(kill=True)
