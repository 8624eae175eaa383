"""Show what a recording holds (array, frames, UEs, times, whether it was closed properly), or a chart log.

chachart info capture.mcap
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.files.chart_log import ChartLogReader, is_chart_log
from chachart.node.files.recording import RecordingReader
from chachart.node.files.recording_totals import RecordingSummary

MOST_SENDERS = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart info`."""
    parser.add_argument("recording", type=Path, metavar="FILE.mcap", help="the recording or chart log")
    parser.add_argument("--json", action="store_true", help="print it as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print what the recording holds.

    Raises
    ------
    SetupError
        If there is no such recording.
    """
    path = arguments.recording
    if is_chart_log(path):
        log = log_as_json(ChartLogReader(path))
        _show(log, list(log_lines(log)), arguments.json)
        return 0
    summary = RecordingReader(path).summary()
    _show(as_json(summary), list(lines(summary)), arguments.json)
    return 0


def _show(values: dict[str, Any], told: list[tuple[str, str]], as_values: bool) -> None:
    if as_values:
        print(json.dumps(values, indent=2))
        return
    width = max(len(name) for name, _ in told)
    for name, value in told:
        print(f"{name:<{width}}  {value}")


def log_as_json(reader: ChartLogReader) -> dict[str, Any]:
    """What a chart log holds, as plain values."""
    rows, ues, methods = 0, set[int](), dict[str, int]()
    first = last = None
    for chart in reader.charts():
        rows += len(chart)
        ues.update(chart.ue.tolist())
        method = f"{chart.method.theta}/{chart.method.rho}"
        methods[method] = methods.get(method, 0) + len(chart)
        start, end = int(chart.time_ns.min()), int(chart.time_ns.max())
        first, last = min(first or start, start), max(last or end, end)
    reports = list(reader.quality())
    return {
        "rows": rows,
        "ues": len(ues),
        "methods": methods,
        "start_ns": first,
        "end_ns": last,
        "bytes": reader.path.stat().st_size,
        "damaged": reader.damaged.as_dict(),
        "quality_reports": len(reports),
        "quality": reports[-1] if reports else None,
        "array": reader.array.as_dict(),
    }


def log_lines(log: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What there is to say of a chart log, as pairs of name and value."""
    yield "chart log", f"{log['rows']} rows of {log['ues']} UEs"
    yield (
        "methods",
        ", ".join(f"{method} ({count} rows)" for method, count in log["methods"].items()) or "none",
    )
    if log["start_ns"] is not None:
        yield "from", _utc(log["start_ns"])
        yield "to", f"{_utc(log['end_ns'])} ({(log['end_ns'] - log['start_ns']) / 1e9:.3f} s)"
    yield "size", f"{log['bytes'] / 1e6:.1f} MB"
    if log["damaged"]:
        yield "damaged", ", ".join(f"{n} {reason}" for reason, n in log["damaged"].items())
    if log["quality"]:
        shares = [
            f"{name.upper()} {log['quality'][name]:.4f}" for name in ("tw", "ct") if name in log["quality"]
        ]
        yield "quality", f"{log['quality_reports']} reports, the last: {', '.join(shares)}"
    array = log["array"]
    yield "array", f"{array['name']}: {array['antennas']} antennas, {array['subcarriers']} subcarriers"


def as_json(summary: RecordingSummary) -> dict[str, Any]:
    """The summary as plain values."""
    return {
        "frames": summary.frames,
        "ues": summary.ues,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "seconds": summary.seconds,
        "bytes": summary.size,
        "closed_properly": summary.closed_properly,
        "damaged": dict(summary.damaged),
        "array": summary.array.as_dict(),
        "facts": summary.facts.as_dict(),
        "note": dict(summary.note),
    }


def lines(summary: RecordingSummary) -> Iterator[tuple[str, str]]:
    """What there is to say, as pairs of name and value."""
    array = summary.array
    yield "frames", f"{summary.frames} of {summary.ues} UEs"
    if summary.start_ns is not None and summary.end_ns is not None:
        yield "from", _utc(summary.start_ns)
        yield "to", f"{_utc(summary.end_ns)} ({summary.seconds:.3f} s)"
    yield "size", f"{summary.size / 1e6:.1f} MB"
    yield "closed", "properly" if summary.closed_properly else "no: the writer was killed or still writes"
    if summary.damaged:
        yield "damaged", ", ".join(f"{n} {reason}" for reason, n in summary.damaged.items())
    yield "array", f"{array.name}: {array.antennas} antennas {array.element_spacing_m:.4g} m apart"
    yield (
        "position",
        f"{_vector(array.position_m)} m, axis {_vector(array.axis)}, looks to {_vector(array.broadside)}",
    )
    if array.height_m is not None:
        yield "height", f"{array.height_m:g} m above the UEs"
    yield "carrier", f"{array.carrier_hz / 1e6:g} MHz (wavelength {array.wavelength_m:.4g} m)"
    yield (
        "subcarriers",
        f"{array.subcarriers}, {_tones(array)}{array.subcarrier_spacing_hz / 1e3:g} kHz apart "
        f"(ranges unambiguous to {array.unambiguous_rho_m:.1f} m)",
    )
    for what, dead in (("antennas", array.dead_antennas), ("subcarriers", array.dead_tones)):
        if dead:
            yield f"dead {what}", " ".join(map(str, dead))
    if array.calibration is not None:
        moved = sum(n != m for n, m in enumerate(array.calibration.antenna_order))
        turned = np.angle(np.exp(1j * np.array(array.calibration.antenna_phase_rad)))
        phase = np.degrees(np.sqrt(np.mean(turned**2)))
        yield "calibration", f"antenna phases {phase:.1f} degrees rms, {moved} antennas on others' inputs"
    yield from _facts(summary.facts)
    for name, value in summary.note.items():
        yield name.replace("_", " "), value if isinstance(value, str) else json.dumps(value)


def _tones(array: ArrayGeometry) -> str:
    """Where the tones are, in words, if they are not 0 ... N_S - 1."""
    if array.tones is None:
        return ""
    return f"tones {array.tones[0]} to {array.tones[-1]} of a grid "


def _facts(facts: CaptureFacts) -> Iterator[tuple[str, str]]:
    """What the CSI means, where it is not that of a coherent array with a clock."""
    if facts.phase == "random":
        yield "phase", "random from frame to frame: frames are not added up coherently"
    if facts.delay == "relative":
        yield "delay", "relative: no distance comes from it"
    if facts.power != "raw":
        yield "power", "scaled to RSSI" if facts.power == "rssi" else "the receiver's gain is undone"
    if facts.senders:
        names = [f"{name} (UE {ue})" for ue, name in list(facts.senders.items())[:MOST_SENDERS]]
        yield "senders", ", ".join(names) + (", ..." if len(facts.senders) > MOST_SENDERS else "")


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + " UTC"


def _vector(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"
