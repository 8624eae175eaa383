"""Ask and steer a running node that has a `control` sink.

chachart ctl status                         how the node is
chachart ctl ues                            who is in the chart
chachart ctl spectrum 7                     where UE 7 is, and both its spectra (--json)
chachart ctl method music bartlett          estimate theta and rho with these from now on
chachart ctl record start lab.mcap          record the CSI that comes in, into the node's recording folder
chachart ctl record stop
chachart ctl replay --speed 5 --at 30       a recording that is played: pace and place; --pause, --play
chachart ctl snapshot chart.csv             the whole chart as .csv or .json
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import zmq

from chachart.node.commands.exporting.rows import Table, write_csv
from chachart.node.commands.shared.cli import add_key_options
from chachart.node.data.chart import ChartUpdate
from chachart.node.data.columns import COLUMNS
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.net.keys import connect_with
from chachart.node.net.security import TOKEN_VARIABLE, SecuritySettings, Tokens

ENDPOINT = "tcp://127.0.0.1:5557"

Reply = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart ctl`; options may stand before or after the operation."""
    nothing = dict.fromkeys(("token", "token_file", "key", "server_key"))
    _add_options(parser, endpoint=ENDPOINT, timeout=10.0, json=False, **nothing)
    shared = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    _add_options(shared)
    operations = parser.add_subparsers(metavar="OPERATION", required=True)

    def operation(name: str, purpose: str, show: Callable[[Reply, argparse.Namespace], None]) -> Any:
        added = operations.add_parser(name, help=purpose, parents=[shared])
        added.set_defaults(op=name, show=show)
        return added

    operation("status", "how the node is", _show_status)
    operation("ues", "who is in the chart", show_ues)
    operation("spectrum", "one UE's spectra", _show_spectrum).add_argument("ue", type=int, metavar="UE")
    method = operation("method", "choose how theta and rho are estimated", _show_method)
    method.add_argument("theta", metavar="THETA")
    method.add_argument("rho", metavar="RHO")
    record = operation("record", "start or stop a recording", _show_record).add_subparsers(required=True)
    start = record.add_parser("start", help="record to PATH, a file name in the node's recording folder")
    start.add_argument("path", metavar="PATH")
    packed = {"dest": "compression", "action": "store_const", "const": "zstd"}
    start.add_argument("--zstd", help="compress it", **packed)
    start.set_defaults(on=True, compression="none")
    record.add_parser("stop", help="close the recording").set_defaults(on=False)
    replay = operation("replay", "pause, pace and wind a recording that is played", _show_replay)
    replay.add_argument("--pause", dest="paused", action="store_true", default=None, help="stand still")
    replay.add_argument("--play", dest="paused", action="store_false", help="go on; at the end, begin anew")
    replay.add_argument("--speed", type=float, metavar="X", help="times the recorded pace; 0: full speed")
    replay.add_argument("--at", dest="at_s", type=float, metavar="S", help="go on from there")
    snapshot = operation("snapshot", "save the whole chart as .csv or .json", _save)
    snapshot.add_argument("file", type=Path, metavar="FILE")
    snapshot.set_defaults(op="chart")


def _add_options(parser: argparse.ArgumentParser, **defaults: Any) -> None:
    parser.add_argument("--endpoint", help=f"the node's control endpoint ({ENDPOINT})")
    parser.add_argument("--token", help=f"the node's token; others see it here, not in ${TOKEN_VARIABLE} or")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="a file that holds it (chmod 600)")
    add_key_options(parser)
    parser.add_argument("--timeout", type=float, metavar="S", help="seconds to wait (10)")
    parser.add_argument("--json", action="store_true", help="print the node's answer as JSON")
    parser.set_defaults(**defaults)


def run(arguments: argparse.Namespace) -> int:
    """Ask, and show what the node answers.

    Raises
    ------
    SetupError
        If no node answers, or it cannot do what was asked; the line says why.
    """
    if "file" in arguments and arguments.file.suffix not in (".csv", ".json"):
        raise SetupError(f"{arguments.file}: a snapshot is a .csv or a .json file")
    names = ("op", "ue", "theta", "rho", "on", "path", "paused", "speed", "at_s", "token")
    request = {name: value for name in names if (value := getattr(arguments, name, None)) is not None}
    request.setdefault("token", _token(arguments.token_file))
    keys = arguments.key, arguments.server_key
    reply = ask(arguments.endpoint, request, arguments.timeout, *keys)
    if arguments.json and "file" not in arguments:
        print(json.dumps(reply, indent=2))
    else:
        arguments.show(reply, arguments)
    return 0


def _token(path: Path | None) -> str | None:
    if path is None:
        return os.environ.get(TOKEN_VARIABLE)
    return Tokens.of(SecuritySettings(token_file=path), from_environment=False).steer


def ask(
    endpoint: str,
    request: dict[str, Any],
    timeout: float,
    key: Path | None = None,
    server_key: Path | None = None,
) -> Reply:
    """A control sink's answer to one request; a key and the node's key where it wants one.

    Raises
    ------
    SetupError
        If nobody answers within `timeout` seconds, or the answer is an error.
    """
    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.linger = 0
        connect_with(socket, key, server_key)
        socket.ipv6 = "[" in endpoint
        try:
            socket.connect(endpoint)
        except zmq.ZMQError as error:
            raise SetupError(f"{endpoint} is no ZeroMQ endpoint: {error.strerror}") from None
        socket.send(msgpack.packb(request))
        if not socket.poll(int(timeout * 1e3)):
            raise SetupError(
                f"no node answers at {endpoint} within {timeout:g} s; does it run, with a control sink there?"
            )
        reply = msgpack.unpackb(socket.recv())
    if not reply["ok"]:
        raise SetupError(reply["error"])
    result: Reply = reply["result"]
    return result


def _show_status(status: Reply, _: argparse.Namespace) -> None:
    quality = status["quality"] or {}
    lost = ", ".join(f"{n} {why}" for why, n in {**status["dropped"], **status["rejected"]}.items() if n)
    latency = status["latency_ms"]
    lines = {
        "state": f"{status['state']} for {status['seconds']:.0f} s",
        **{name: status[key] for name, key in (("why", "reason"), ("fix", "fix")) if status[key]},
        "method": f"theta {status['method']['theta']}, rho {status['method']['rho']}",
        "frames": f"{status['frames_in']} in, {status['frames_estimated']} estimated, "
        f"{status['backlog_frames']} waiting, {status['frames_estimated_per_s']:.0f} per s",
        "lost": lost or "nothing",
        "UEs": str(status["ues"]),
        "latency": f"{_number(latency.get('p50'))} ms, 99 % within {_number(latency.get('p99'))} ms",
        "workers": ", ".join(_worker(worker) for worker in status["workers"]),
        "quality": f"TW {_number(quality.get('tw'), 4)}, CT {_number(quality.get('ct'), 4)}",
        "recording": status["recording"] or "no",
    }
    for name, text in lines.items():
        print(f"{name:<10} {text}")


def _worker(worker: Reply) -> str:
    where = f" on {worker['host']}" if "host" in worker else ""
    return f"{worker['ues']} UEs{where}, {worker['restarts']} restarts"


def show_ues(reply: Reply, _: object = None) -> None:
    """Print the answer to `ues` as a table of all columns that there are."""
    first = reply["ues"][0] if reply["ues"] else {}
    shown = [column for column in COLUMNS.values() if column.name in first and column.unit != "ns"]
    table = [[f"{column.label} {column.for_people()[0]}".strip() for column in shown]]
    table += [[column.text(ue[column.name]) for column in shown] for ue in reply["ues"]]
    widths = [max(map(len, cells)) for cells in zip(*table, strict=True)]
    for row in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def _show_spectrum(reply: Reply, _: argparse.Namespace) -> None:
    for name, unit, scale in (("theta", "degrees", 180 / math.pi), ("rho", "m", 1.0)):
        value, std = (reply.get(key) for key in (name, f"{name}_std"))
        value, std = (None if v is None else v * scale for v in (value, std))
        print(f"{name:<6} {_number(value, 3)} {unit}, standard deviation {_number(std, 3)}")


def _show_method(reply: Reply, _: argparse.Namespace) -> None:
    print(f"theta {reply['theta']}, rho {reply['rho']}")


def _show_record(reply: Reply, arguments: argparse.Namespace) -> None:
    print(f"{'recording to' if arguments.on else 'closed'} {reply.get('where')}")


def _show_replay(reply: Reply, _: argparse.Namespace) -> None:
    how = (
        "at its end"
        if reply["ended"]
        else "paused"
        if reply["paused"]
        else f"{reply['speed']:g} times the pace"
    )
    print(f"{reply['at_s']:.1f} s of {reply['length_s']:.1f} s, {how}")


def _save(chart: Reply, arguments: argparse.Namespace) -> None:
    if not chart:
        raise SetupError("the chart is empty yet")
    save_chart(chart, arguments.file)
    print(f"{len(chart['ue'])} UEs to {arguments.file}", file=sys.stderr)


def save_chart(chart: Reply, path: Path) -> None:
    """Write the answer to `chart` as CSV, as `chachart export` does, or as it is.

    Raises
    ------
    SetupError
        If the file cannot be written.
    """
    try:
        if path.suffix == ".json":
            path.write_text(json.dumps(chart))
        else:
            update = ChartUpdate.from_plain(chart)
            table = Table(update.columns, ArrayGeometry.from_dict(chart["geometry"]))
            write_csv(path, [update], table)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from None


def _number(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
