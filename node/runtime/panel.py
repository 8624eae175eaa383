"""The status of a node for people: one live panel in a terminal, one line in a pipe, a summary at the end."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

_STATE_STYLE = {"running": "green", "degraded": "red", "stopped": "dim"}


def panel(status: dict[str, Any], width: int = 120) -> Panel:
    """A status report (`chachart.node.runtime.status.NodeStatus`) as a panel of so many columns."""
    latency, quality = status["latency_ms"], status["quality"] or {}
    cells = [
        ("frames in", f"{status['frames_in_per_s']:,.0f}/s"),
        ("estimates", f"{status['frames_estimated_per_s']:,.0f}/s"),
        ("UEs", f"{status['ues']:,}"),
        ("backlog", f"{status['backlog_frames']:,} frames"),
        ("latency p50", _ms(latency.get("p50"))),
        ("latency p99", _ms(latency.get("p99"))),
        ("TW", _figure(quality.get("tw"))),
        ("CT", _figure(quality.get("ct"))),
        ("frames in all", f"{status['frames_in']:,}"),
        ("estimated", f"{status['frames_estimated']:,}"),
        ("dropped", counts(status["dropped"])),
        ("rejected", counts(status["rejected"])),
    ]
    figures = _grid([Text.assemble((f"{name} ", "dim"), (value, "bold")) for name, value in cells], width - 4)
    parts: list[RenderableType] = [figures, Text()]
    if status["reason"]:
        parts += [Text(words(status), "red"), Text()]
    parts += [_source(source) for source in status["sources"]]
    parts += [Text.assemble((f"array {one['name']} ", "dim"), array_words(one)) for one in status["arrays"]]
    parts += [_worker(worker) for worker in status["workers"]]
    parts += [
        Text.assemble((f"{sink['name']} ", "dim"), sink["where"], _lost(sink))
        for sink in status["sinks"]
        if sink["where"]
    ]
    method = status["method"]
    title = Text.assemble(
        f" {status['array']} · ",
        (status["state"], _STATE_STYLE.get(status["state"], "yellow")),
        f" · {method.get('theta')}/{method.get('rho')} · {status['seconds']:.0f} s ",
    )
    return Panel(Group(*parts), title=title, subtitle=" Ctrl-C drains and ends ", title_align="left")


def _grid(cells: list[Text], width: int) -> Table:
    """Cells in rows of as many as the width has room for, four at most; one that is wider wraps."""
    gap, across = 3, 1
    for n in (4, 3, 2):
        columns = [max(cell.cell_len for cell in cells[i::n]) for i in range(n)]
        if sum(columns) + gap * (n - 1) <= width:
            across = n
            break
    grid = Table.grid(padding=(0, gap))
    for start in range(0, len(cells), across):
        grid.add_row(*cells[start : start + across])
    return grid


def line(status: dict[str, Any]) -> str:
    """A status report as one line for a log."""
    latency, quality = status["latency_ms"], status["quality"] or {}
    return (
        f"{words(status)}: {status['frames_in_per_s']:.0f} frames/s in, "
        f"{status['frames_estimated_per_s']:.0f} estimated/s, {status['ues']} UEs, "
        f"backlog {status['backlog_frames']}, dropped {counts(status['dropped'])}, "
        f"latency p50 {_ms(latency.get('p50'))} p99 {_ms(latency.get('p99'))}, "
        f"TW {_figure(quality.get('tw'))} CT {_figure(quality.get('ct'))}"
    )


def words(status: dict[str, Any]) -> str:
    """How the node is, why, and what would help.

    >>> words({"state": "degraded", "reason": "no frames for 7 s", "fix": "is the front-end on?"})
    'degraded (no frames for 7 s; is the front-end on?)'
    """
    why = "; ".join(text for text in (status["reason"], status["fix"]) if text)
    return f"{status['state']} ({why})" if why else str(status["state"])


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """What a node prints when it has ended."""
    quality, seconds = summary["quality"], summary["seconds"]
    rate = summary["frames_estimated"] / seconds if seconds else 0.0
    lines = [
        f"frames in {summary['frames_in']}, estimated {summary['frames_estimated']}, "
        f"dropped {counts(summary['dropped'])}, rejected {counts(summary['rejected'])}",
        f"{seconds:.2f} s, {rate:.0f} frames/s, {summary['ues']} UEs, "
        f"latency p50 {_ms(summary['latency_ms']['p50'])} p99 {_ms(summary['latency_ms']['p99'])}, "
        f"worker restarts {summary['worker_restarts']}",
    ]
    if quality is not None:
        lines.append(f"TW {_figure(quality['tw'])} CT {_figure(quality['ct'])} (K = {quality['k']})")
    lines += [
        f"sink {sink['name']} ({sink['where']}): dropped {counts(sink['dropped'])}, {sink['errors']} errors"
        for sink in summary["sinks"]
        if sink["dropped"] or sink["errors"]
    ]
    return lines


def array_words(array: dict[str, Any]) -> str:
    """How one of several arrays does.

    >>> array_words({"name": "C", "share": 0.4, "offset_ns": 3.1, "offset_std_ns": 0.2})
    '40 % of the transmissions, clock 3.1 ± 0.2 ns late'
    """
    std = array.get("offset_std_ns")
    about = "" if std is None else f" ± {std:.1f}"
    late = "" if array["offset_ns"] is None else f", clock {array['offset_ns']:.1f}{about} ns late"
    if array.get("drift_ns") is not None:
        late += f" ({array['drift_ns']:+.1f} since calibration)"
    return f"{100 * array['share']:.0f} % of the transmissions{late}"


def counts(by_reason: dict[str, int]) -> str:
    """`12 (queue_full 10, worker_lost 2)`, or `0`.

    >>> counts({"queue_full": 10, "worker_lost": 2})
    '12 (queue_full 10, worker_lost 2)'
    """
    listed = ", ".join(f"{reason} {n}" for reason, n in sorted(by_reason.items()) if n)
    return f"{sum(by_reason.values())} ({listed})" if listed else "0"


def _worker(worker: dict[str, Any]) -> Text:
    absent = worker["pid"] is None
    return Text.assemble(
        (f"worker {worker['shard']} ", "dim"),
        ("restarting" if worker["restarts"] else "starting", "yellow")
        if absent
        else f"process {worker['pid']}",
        f", {worker['ues']:,} UEs, backlog {worker.get('backlog_frames', 0):,}, ",
        f"restarts {worker['restarts']}",
    )


def _source(source: dict[str, Any]) -> Text:
    absent = source["pid"] is None and not source["ended"]
    return Text.assemble(
        (f"array {source['name']} ", "dim"),
        f"source {source['type']}, {source['frames']:,} frames",
        (", restarting", "yellow") if absent else "",
        f", restarts {source['restarts']}",
    )


def _lost(sink: dict[str, Any]) -> tuple[str, str]:
    return (f"  dropped {counts(sink['dropped'])}", "red") if sink["dropped"] else ("", "")


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} ms"


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.4f}"
