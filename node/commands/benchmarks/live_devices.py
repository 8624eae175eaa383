"""Live devices: each simulated device over its socket or pty, whole and damaged."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import Any

from chachart.config.registry import source_class
from chachart.node.commands.benchmarks.report import Table
from chachart.node.data.csi import CsiBlock
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.estimation.estimator import ChartEstimator
from chachart.sources.base import EndOfSource
from chachart.sources.formats.wifi import tones
from chachart.sources.live.device import DeviceSource
from chachart.sources.live.krakensdr.receiver import KrakenFaults
from chachart.sources.simulator import Simulator, SimulatorSettings

RATE_HZ = 2000.0
"""UDP has no brake: faster than a source reads, the system drops datagrams."""
GIVE_UP_S = 60.0
KRAKEN_SHARE = 10
"""A frame of KrakenSDR is 4096 samples of five channels: a tenth as many are enough."""
FAULTS = {"krakensdr": {"unsynchronous": 0.01, "overdrive": 0.01, "calibrating": 0.01}}
_NOT_GOOD = ("unsynchronous", "overdriven", "calibrating")
_HT = tones.carrying("ht", 20)
_NEXMON = tuple(n for n in _HT if n not in (28, 29, 30))
WIFI: dict[str, tuple[int, tuple[int, ...]]] = {
    "nexmon": (4, _NEXMON),
    "nexmon_pcap": (2, _NEXMON),
    "picoscenes": (2, tuple(range(-32, 32))),
    "feitcsi": (2, _HT),
    "intel5300": (3, tones.intel5300(20).numbers or ()),
    "esp32": (1, tones.carrying("legacy", 20)),
    "openwifi": (1, _HT),
}


@dataclass(frozen=True, slots=True)
class Device:
    """A device: its source's type, its array, and what it is told apart from faults and frames."""

    type: str
    array: ArrayGeometry
    settings: dict[str, Any]


def devices() -> dict[str, Device]:
    """All live devices by name."""
    found = {
        f"wifi {tool}": Device(
            "wifi",
            ArrayGeometry("wifi", antennas, len(numbers), 5.18e9, 312_500.0, 0.029, tones=numbers),
            {"tool": tool},
        )
        for tool, (antennas, numbers) in WIFI.items()
    }
    board = ArrayGeometry("board", 8, 25, 2.472e9, 625_000.0, 0.06)
    found["espargos"] = Device("espargos", board, {"calibrate_s": 0.2})
    found["oai"] = Device("oai", ArrayGeometry("gnb", 4, 16, 3.6e9, 480_000.0, 0.0416), {})
    found["krakensdr"] = Device("krakensdr", ArrayGeometry("kraken", 5, 16, 433e6, 12_500.0, 0.3), {})
    return found


def tables(frames: int) -> list[Table]:
    """Whole links, and links with damage, of every live device."""
    whole = Table(
        "live devices, whole: simulated device to blocks of CSI, both in this process",
        ["device", "frame", "sent", "arrived", "frames/s", "largest difference of theta, deg"],
    )
    faults = Table(
        "the same with 1 % damaged, never sent, and reordered (datagrams), or not good as a receiver says",
        ["device", "sent whole", "arrived", "of theta, deg", "damaged", "not sent", "left out by reason"],
    )
    for name, device in devices().items():
        shape = f"{device.array.antennas} x {device.array.subcarriers}"
        passed = passage(device, frames, {})
        whole.add(
            name, shape, passed.sent, passed.arrived, passed.arrived / passed.seconds, passed.theta_off_deg
        )
        hit = passage(
            device, frames, FAULTS.get(device.type, {"drop": 0.01, "corrupt": 0.01} | _reordered(device))
        )
        reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(hit.rejected.items()))
        faults.add(name, hit.sent, hit.arrived, hit.theta_off_deg, hit.damaged, hit.dropped, reasons)
    return [whole, faults]


@dataclass(frozen=True, slots=True)
class Passage:
    """What became of frames, as the device and its source tell; KrakenSDR's arrive once a transmitter."""

    sent: int
    damaged: int
    dropped: int
    arrived: int
    rejected: dict[str, int]
    seconds: float
    theta_off_deg: float | None
    """Largest difference of a UE's angle in the chart from what the device's own world gives, or from where
    KrakenSDR's transmitters are; None where the device has one antenna, or does not say who sent."""


def passage(device: Device, frames: int, faults: dict[str, float]) -> Passage:
    """Play so many frames through a simulated device and its source, and read them all.

    Raises
    ------
    OSError
        If nothing came for a long time.
    """
    loopback: dict[str, Any] = {**faults}
    if device.type == "krakensdr":
        loopback |= {"frames": max(1, frames // KRAKEN_SHARE), "samples": 4096, "rate_hz": 1_000_000}
    else:
        loopback["scenario"] = {"ues": 8, "frame_rate_hz": RATE_HZ, "snr_db": 200.0, "frames": frames}
    cls = source_class(device.type)
    settings = cls.Settings.model_validate({"type": device.type, **device.settings, "loopback": loopback})
    blocks: list[CsiBlock] = []
    first, last = 0.0, time.perf_counter()
    with cls(settings, device.array) as source:
        assert isinstance(source, DeviceSource)
        while True:
            try:
                block = source.recv(0.1)
            except EndOfSource:
                break
            now = time.perf_counter()
            if block is not None:
                first, last = first or now, now
                blocks.append(block)
            elif now - last > GIVE_UP_S:
                raise OSError(
                    f"{device.type}: after {sum(map(len, blocks))} frames nothing came for {GIVE_UP_S:g} s"
                )
        assert source.simulated is not None
        told, rejected = asdict(source.simulated.report), source.rejected.as_dict()
    damaged = told.get("corrupted", 0) + sum(told.get(name, 0) for name in _NOT_GOOD)
    sent = told.get("sent", told.get("good", 0))
    arrived, seconds = sum(map(len, blocks)), max(last - first, 1e-9)
    off = theta_off_deg(device, blocks, loopback.get("scenario"))
    return Passage(sent, damaged, told.get("dropped", 0), arrived, rejected, seconds, off)


def theta_off_deg(device: Device, blocks: list[CsiBlock], scenario: dict[str, Any] | None) -> float | None:
    """How far the chart of these blocks is from the device's own world at most."""
    if device.array.antennas == 1:
        return None
    found = _thetas(device.array, blocks)
    if scenario is None:
        truth = {
            round(device.array.carrier_hz + one.offset_hz): math.radians(abs(one.azimuth_deg))
            for one in KrakenFaults().transmitters
        }
    else:
        still = SimulatorSettings.model_validate(
            {**scenario, "frame_rate_hz": 0.0, "frames": scenario["ues"]}
        )
        with Simulator(still, device.array) as simulator:
            block = simulator.recv(GIVE_UP_S)
        truth = _thetas(device.array, [block] if block is not None else [])
    return math.degrees(max(abs(theta - truth[ue]) for ue, theta in found.items()))


def _thetas(array: ArrayGeometry, blocks: list[CsiBlock]) -> dict[int, float]:
    estimator = ChartEstimator(array, theta="bartlett", rho="none", averaging="mean")
    found: dict[int, float] = {}
    for block in blocks:
        rows = estimator.update(block)
        found.update(zip(rows.ue.tolist(), rows.theta.tolist(), strict=True))
    return found


def _reordered(device: Device) -> dict[str, float]:
    """Of devices that send datagrams."""
    return {"reorder": 0.01} if device.type in ("espargos", "wifi") else {}
