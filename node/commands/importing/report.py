"""What an import tells at its end: what was kept, what was left out and why, what the file cannot give."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from chachart.node.commands.importing.table import CaptureTable, Part
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry

MOST_SENDERS = 8


def note(parts: list[Part], capture_format: str, options: dict[str, Any]) -> dict[str, Any]:
    """What the recording keeps of the import, as plain values."""
    return {
        "imported_from": ", ".join(part.source.name for part in parts),
        "format": capture_format,
        "frames_in_file": sum(part.frames_in_file for part in parts),
        "left_out": dict(_left_out(parts)),
        **options,
    }


def lines(
    parts: list[Part],
    table: CaptureTable,
    array: ArrayGeometry,
    facts: CaptureFacts,
    remarks: list[str],
    antenna_names: tuple[str, ...],
) -> list[tuple[str, str]]:
    """The report, as pairs of name and value."""
    frames = sum(part.frames_in_file for part in parts)
    kept = sum(len(np.unique(part.number)) for part in parts)
    found = [("kept", f"{kept} of {frames} frames" + (f" of {len(parts)} files" if len(parts) > 1 else ""))]
    found += [("left out", f"{count} ({reason})") for reason, count in _left_out(parts).items()]
    if antenna_names:
        found.append(("antennas", " + ".join(antenna_names)))
    if array.tones is not None:
        found.append(("subcarriers", f"numbers {array.tones[0]} to {array.tones[-1]} of {_khz(array)} kHz"))
    found += _senders(table, facts)
    if table.time_ns is not None and len(table.time_ns) > 1:
        seconds = float(np.ptp(table.time_ns)) / 1e9
        rate = f", {(len(table.ue) - 1) / seconds:.1f} frames/s" if seconds else ""
        found.append(("duration", f"{seconds:.3f} s{rate}"))
    snr = [part.snr_db for part in parts if part.snr_db is not None]
    if snr:
        found.append(("mean SNR", f"{float(np.nanmean(np.concatenate(snr))):.1f} dB (RSSI over noise floor)"))
    found += [(part.source.name, remark) for part in parts for remark in part.remarks]
    found += [("note", remark) for remark in remarks]
    found += [("cannot", missing) for missing in _cannot(array, facts, bool(snr), table)]
    return found


def _left_out(parts: list[Part]) -> Counter[str]:
    total: Counter[str] = Counter()
    for part in parts:
        total += part.left_out
    return total


def _senders(table: CaptureTable, facts: CaptureFacts) -> list[tuple[str, str]]:
    if not facts.senders:
        return []
    ues, counts = np.unique(table.ue, return_counts=True)
    ranked = sorted(zip(ues.tolist(), counts.tolist(), strict=True), key=lambda row: -row[1])
    found = [
        ("sender", f"{facts.senders.get(ue, 'not said')}: {count} frames, UE {ue}")
        for ue, count in ranked[:MOST_SENDERS]
    ]
    if len(ranked) > MOST_SENDERS:
        found.append(("sender", f"and {len(ranked) - MOST_SENDERS} more"))
    return found


def _cannot(array: ArrayGeometry, facts: CaptureFacts, has_snr: bool, table: CaptureTable) -> list[str]:
    """What no chart of these frames can show."""
    found = []
    if array.antennas - len(array.dead_antennas) < 2:
        found.append("one antenna: no direction, only how far or how strong")
    if facts.delay == "relative":
        amplitude = (
            "amplitude is, up to a factor" if facts.power == "rssi" else "amplitude neither, without RSSI"
        )
        found.append(f"no common clock: delay is no distance; {amplitude}")
    if facts.phase == "random":
        found.append("each frame has a phase of its own: frames are not added up coherently")
    if table.position is None:
        found.append("no known positions: nothing to compare a chart with (--position, --position-from)")
    if not has_snr:
        found.append("no noise floor: SNR is what the estimators make of it")
    return found


def _khz(array: ArrayGeometry) -> str:
    return f"{array.subcarrier_spacing_hz / 1e3:g}"
