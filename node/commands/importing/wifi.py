"""The frames of Wi-Fi captures: which kind of them is kept, and what their columns are used for."""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from chachart.node.commands.importing.table import Band, Part
from chachart.node.data.errors import SetupError
from chachart.sources.formats.wifi.capture import WifiCapture
from chachart.sources.formats.wifi.log import Group, Kind, Tones, mac

NO_SENDER = 0
"""UE id of frames whose sender is not known."""
_MOST_KINDS = 8
_QUIET_NOISE_DBM = (-115, -60)
"""A noise floor outside is not a measured one: the tools write -127, -128 or 0 for none."""


def chosen(captures: list[WifiCapture], arguments: argparse.Namespace) -> tuple[Kind, list[str]]:
    """The kind of frames to keep: of those that the options ask for the commonest over all files.

    Also a line for each other kind, with the option that picks it.

    Raises
    ------
    SetupError
        If there is none; the message lists what there is.
    """
    counts: Counter[Kind] = Counter()
    for capture in captures:
        for group in capture.log.groups:
            counts[group.kind] += len(group)
    ranked = sorted(counts, key=lambda kind: -counts[kind])
    fitting = [kind for number, kind in enumerate(ranked, 1) if _wanted(kind, number, arguments)]
    if not fitting:
        listing = "".join(f"\n  {n}: {counts[kind]} frames of {kind}" for n, kind in enumerate(ranked, 1))
        raise SetupError(
            f"{captures[0].path}: no frames are as --kind, --antennas, --streams, --tones, --bandwidth ask; "
            f"there are{listing}"
        )
    others = [
        f"--kind {number} picks {counts[kind]} frames of {kind}"
        for number, kind in enumerate(ranked[:_MOST_KINDS], 1)
        if kind != fitting[0]
    ]
    if len(ranked) > _MOST_KINDS:
        others.append(f"--kind up to {len(ranked)} picks rarer ones")
    return fitting[0], others


def _wanted(kind: Kind, number: int, arguments: argparse.Namespace) -> bool:
    antennas = arguments.antennas
    return (
        arguments.kind in (None, number)
        and (antennas is None or antennas in (str(kind.antennas), "".join(kind.antenna_names)))
        and arguments.streams in (None, kind.streams)
        and (not arguments.tones.isdecimal() or int(arguments.tones) == kind.subcarriers)
        and (arguments.bandwidth is None or arguments.bandwidth * 1e6 == kind.bandwidth_hz)
    )


def has(capture: WifiCapture, kind: Kind) -> bool:
    """Whether a capture has frames of this kind."""
    return any(group.kind == kind for group in capture.log.groups)


def power_of(captures: list[WifiCapture], kind: Kind, asked: str) -> str:
    """What is done about power: `auto` becomes `rssi` where every frame has it, else `raw`."""
    if asked != "auto":
        return asked
    groups = [group for capture in captures for group in capture.log.groups if group.kind == kind]
    known = all("rssi_dbm" in g.columns and np.isfinite(g.columns["rssi_dbm"]).all() for g in groups)
    return "rssi" if known else "raw"


def part_of(capture: WifiCapture, kind: Kind, power: str, arguments: argparse.Namespace) -> tuple[Part, Band]:
    """The frames of this kind in a capture that has some, and what is known of their subcarriers.

    Raises
    ------
    SetupError
        If a variable is not there, or an option does not fit.
    """
    log = capture.log
    group = next(group for group in log.groups if group.kind == kind)
    capture.choose(group)
    if arguments.csi == "all":
        tones, csi = kind.tones, np.concatenate(list(group.csi.transpose(2, 0, 1, 3)))
        rows = np.tile(np.arange(len(group)), kind.streams)
        order = np.argsort(rows, kind="stable")
        csi, rows = csi[order], rows[order]
    else:
        (tones, csi), rows = capture.csi(arguments.csi or "csi"), np.arange(len(group))
    place = _places(tones, csi.shape[2], arguments)
    left_out = Counter(log.left_out)
    for other in log.groups:
        if other is not group:
            left_out[other.kind.differs_in(kind, log.order)] += len(other)
    snr_db = _snr(group)
    part = Part(
        capture.path,
        csi[:, :, place],
        _ues(capture, group, arguments)[rows],
        _times(capture, group, arguments)[rows],
        None,
        group.number[rows],
        keep_order=True,
        frames_in_file=log.frames,
        left_out=left_out,
        snr_db=None if snr_db is None else snr_db[rows],
        remarks=[*log.remarks, *_clock_remarks(group, log.clock)],
    )
    weak = tuple(n for n in tones.weak if tones.numbers and n in {tones.numbers[k] for k in place})
    _apply_power(part, group, rows, tones, place, power)
    if arguments.ue_mac is not None and log.has_senders:
        mine = part.ue == np.uint64(arguments.ue_mac)
        if not mine.any():
            senders = ", ".join(mac(int(ue)) for ue in np.unique(part.ue).tolist()[:8])
            raise SetupError(
                f"{capture.path}: --ue-mac {mac(arguments.ue_mac)}: has sent nothing; {senders} have"
            )
        if not mine.all():
            part.left_out["other sender"] += int(np.count_nonzero(~mine))
            part.take(np.flatnonzero(mine))
    numbers = None if tones.numbers is None else tuple(tones.numbers[n] for n in place)
    band = Band(kind.carrier_hz, tones.spacing_hz, numbers, weak, kind.antenna_names)
    return part, band


def _places(tones: Tones, count: int, arguments: argparse.Namespace) -> list[int]:
    """Which subcarriers of the file are kept: those that carry a signal, unless all are asked for."""
    places = list(range(count))
    if tones.numbers is not None and tones.used and arguments.tones != "all":
        used = set(tones.used)
        places = [n for n, number in enumerate(tones.numbers) if number in used]
    places = list(places[arguments.subcarriers])
    if not places:
        raise SetupError(f"--subcarriers: nothing is left of {count} subcarriers")
    return places


def _ues(capture: WifiCapture, group: Group, arguments: argparse.Namespace) -> NDArray[np.uint64]:
    if arguments.ue is not None and arguments.ue.isdecimal():
        return np.full(len(group), int(arguments.ue), np.uint64)
    if arguments.ue not in (None, "ue"):
        raise SetupError(f"--ue {arguments.ue}: must be a number, or left out (the sender)")
    if arguments.ue_mac is not None and not capture.log.has_senders:
        return np.full(len(group), arguments.ue_mac, np.uint64)
    return np.asarray(group.columns["ue"], np.uint64)


def _times(capture: WifiCapture, group: Group, arguments: argparse.Namespace) -> NDArray[np.int64]:
    name = arguments.time or "time"
    if name not in group.columns or np.asarray(group.columns[name]).dtype.kind not in "iu":
        raise SetupError(
            f"--time {name}: {capture.path} has no such column; it has {', '.join(group.columns)}"
        )
    return np.asarray(group.columns[name], np.int64)


def _clock_remarks(group: Group, clock: str) -> list[str]:
    """What is odd about the times, in words."""
    times = np.asarray(group.columns["time"], np.int64)
    steps = np.diff(times)
    found = []
    if len(times) > 1 and not steps.any():
        found.append("its clock does not run: all times are the same")
    if back := int(np.count_nonzero(steps < 0)):
        found.append(f"its clock steps back {back} times ({clock})")
    if len(steps) and steps.max() > 3_600_000_000_000:
        found.append(f"its clock jumps by {steps.max() / 3.6e12:.1f} hours")
    return found


def _snr(group: Group) -> NDArray[np.float64] | None:
    """Signal over noise floor in dB, where the file has both."""
    dbm, noise = group.columns.get("rssi_dbm"), group.columns.get("noise")
    if dbm is None or noise is None:
        return None
    measured = (noise >= _QUIET_NOISE_DBM[0]) & (noise <= _QUIET_NOISE_DBM[1]) & np.isfinite(dbm)
    return np.where(measured, dbm.astype(np.float64) - noise, np.nan) if measured.any() else None


def _apply_power(
    part: Part,
    group: Group,
    rows: NDArray[np.int64],
    tones: Tones,
    place: list[int],
    power: str,
) -> None:
    """Scale the frames to received power, or undo the receiver's gain, as --power says."""
    columns = group.columns
    dbm = columns.get("rssi_dbm", np.full(len(group), np.nan))[rows]
    known = np.isfinite(dbm)
    if power == "rssi":
        if not known.any():
            raise SetupError(f"{part.source}: --power rssi: the file tells no RSSI")
        counts = [
            n for n, k in enumerate(place) if tones.numbers is None or tones.numbers[k] not in tones.weak
        ]
        mean = np.mean(np.square(np.abs(part.csi[:, :, counts]), dtype=np.float64), axis=(1, 2))
        wanted = 10 ** (np.where(known, dbm, 0.0).astype(np.float64) / 10)
        factor = np.sqrt(np.divide(wanted, mean, out=np.zeros(len(mean)), where=mean > 0))
        part.csi = part.csi * factor[:, None, None].astype(np.float32)
        if not known.all():
            part.left_out["no RSSI"] += int(np.count_nonzero(~known))
            part.take(np.flatnonzero(known))
    elif power == "agc":
        if "agc" not in columns:
            raise SetupError(f"{part.source}: --power agc: the file tells no AGC")
        gain_db = columns["agc"][rows] + 0.25 * columns.get("fft", np.zeros(len(group)))[rows]
        part.csi = part.csi * (10 ** (-gain_db / 20))[:, None, None].astype(np.float32)
