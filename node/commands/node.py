# PYTHON_ARGCOMPLETE_OK
"""`chachart-node`: runs a node until its source ends, its time is up, or it is told to stop."""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console
from rich.constrain import Constrain
from rich.live import Live
from rich.logging import RichHandler

from chachart.config.load import load
from chachart.config.shipped import PLAY
from chachart.node.commands.shared.charting import methods_for
from chachart.node.commands.shared.cli import Parser, complete
from chachart.node.data.errors import EX_CONFIG, SetupError
from chachart.node.data.version import build
from chachart.node.files.recording import RecordingReader
from chachart.node.runtime import logs
from chachart.node.runtime.child import leave_alone_what_lives
from chachart.node.runtime.descriptors import raise_limit
from chachart.node.runtime.node import Node
from chachart.node.runtime.panel import line, panel, summary_lines
from chachart.node.runtime.plan import Plan, check

log = logging.getLogger(__name__)

PANEL_EVERY_S = 0.25
LINE_EVERY_S = 5.0
POLL_S = 0.05
ROOM_FOR_CTRL_C = 2
"""Columns right of the panel, so that the terminal's `^C` does not begin a line that nobody wipes."""
SWITCH_INTERVAL_S = 0.0005
"""Sinks must not keep new charts waiting for the interpreter as long as Python's 5 ms."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; gives its exit status: 0, 1 (failed while running), 78 (cannot start as told)."""
    parser = _parser()
    complete(parser)
    options = parser.parse_args(arguments)
    logs.set_up(options.log_format, options.log_level)
    try:
        config, changes = options.config, options.set
        if options.recording is not None:
            if config is None:
                config, changes = PLAY, [*_methods(options.recording), *changes]
            changes = ["source.type=recording", f"source.path={json.dumps(str(options.recording))}", *changes]
        if options.resume:
            changes = [*changes, "state.resume=true"]
        settings = load(config, changes, options.sink)
        mistakes = check(settings) + _summary_problems(options.summary)
        if mistakes:
            raise SetupError("\n".join(mistakes))
        if options.check:
            print(f"{config or 'lab.toml'}: nothing wrong")
            return 0
        return _run(Plan.of(settings), options)
    except SetupError as error:
        print(error, file=sys.stderr)
        return EX_CONFIG


def _methods(recording: Path) -> list[str]:
    """Changes that choose methods which a recording allows, where it does not allow the usual ones."""
    reader = RecordingReader(recording)
    theta, rho, why = methods_for(reader.array, reader.facts)
    if not why:
        return []
    log.info("theta by %s, rho by %s: %s", theta, rho, why)
    return [f"estimator.theta={theta}", f"estimator.rho={rho}"]


def _parser() -> Parser:
    parser = Parser(
        prog="chachart-node",
        description="Turn the CSI of an antenna array into a live channel chart.",
        epilog="Without RECORDING and --config the shipped lab.toml is used: a simulated array and the live "
        "view. `chachart config list` says which configurations there are.",
    )
    parser.add_argument("--version", action="version", version=f"chachart-node {build()}")
    parser.add_argument(
        "recording", nargs="?", type=Path, metavar="RECORDING", help="play a recording, with the live view"
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the node's settings in TOML, or the name of shipped ones"
    )
    parser.add_argument(
        "--sink",
        action="append",
        default=[],
        metavar="TYPE",
        help="add a sink, such as view or chart_log, at its defaults; may be given more than once",
    )
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="change a setting of the file; may be given more than once",
    )
    parser.add_argument("--check", action="store_true", help="say what is wrong with the settings, then exit")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on where a node ended or died, from the snapshots in state.directory",
    )
    parser.add_argument("--duration", type=_seconds, metavar="S", help="drain and exit after S seconds")
    parser.add_argument("--summary", type=Path, metavar="FILE", help="write the summary as JSON")
    parser.add_argument("--log-format", choices=("text", "json"), default="text")
    parser.add_argument(
        "--log-level", choices=("DEBUG", "INFO", "WARNING", "ERROR"), default="INFO", type=str.upper
    )
    return parser


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive number of seconds, not {text}")
    return seconds


def _summary_problems(path: Path | None) -> list[str]:
    if path is None or (path.parent.is_dir() and not path.is_dir() and os.access(path.parent, os.W_OK)):
        return []
    return [f"--summary {path}: cannot be written; it must be a file in a directory that is there"]


class _Signals:
    """The first SIGINT or SIGTERM asks for a drain, the second ends everything at once."""

    def __init__(self, node: Node) -> None:
        self.asked = False
        self._node = node
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            self._node.kill()
            os._exit(128 + number)
        self.asked = True


def _run(plan: Plan, options: argparse.Namespace) -> int:
    console = Console()
    live = None
    if console.is_terminal and options.log_format == "text":
        live = Live(console=console, auto_refresh=False, transient=True)
        logs.set_up(
            "text",
            options.log_level,
            RichHandler(console=console, show_path=False, log_time_format="[%H:%M:%S]"),
        )
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    raise_limit()
    node = Node(plan, logging.getLevelNamesMapping()[options.log_level])
    signals = _Signals(node)
    log.info("chachart %s", build())
    node.start()
    leave_alone_what_lives()
    for name, where in node.addresses():
        log.info("%s: %s", name, where)
    if live is None:
        _follow(node, signals, options.duration, lambda status: log.info(line(status)), LINE_EVERY_S)
    else:
        with live:
            _follow(
                node,
                signals,
                options.duration,
                lambda status: live.update(_panel(status, console.width - ROOM_FOR_CTRL_C), refresh=True),
                PANEL_EVERY_S,
            )
    summary = node.close()
    for text in summary_lines(summary):
        print(text)
    failures = [] if node.failure is None else [node.failure]
    if options.summary is not None:
        try:
            options.summary.write_text(json.dumps(summary, indent=2) + "\n")
        except OSError as error:
            failures.append(f"--summary {options.summary}: cannot be written: {error.strerror}")
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


def _panel(status: dict[str, Any], width: int) -> Constrain:
    return Constrain(panel(status, width), width)


def _follow(
    node: Node,
    signals: _Signals,
    duration: float | None,
    show: Callable[[dict[str, Any]], None],
    every_s: float,
) -> None:
    """Show the status every so often, and tell the node to stop when it is time."""
    next_show, stopping = time.monotonic() + every_s, False
    while not node.wait(POLL_S):
        status = node.status()
        if not stopping and (signals.asked or (duration is not None and status["seconds"] >= duration)):
            stopping = True
            log.info("draining")
            node.stop()
        if time.monotonic() >= next_show:
            next_show += every_s
            show(status)


if __name__ == "__main__":
    sys.exit(main())
