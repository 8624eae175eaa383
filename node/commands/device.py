"""Be a live device: a simulated one, at the other end of real sockets, for a node to listen to.

chachart device espargos                                  a board, its controller on port 8000
chachart device oai --listen 127.0.0.1:2021               a 5G gNB's T tracer
chachart device wifi --set source.tool=feitcsi            a Wi-Fi tool, which sends to --listen
chachart device krakensdr --set source.loopback.frames=100  keys of the source's loopback table
chachart device espargos --config espargos.toml           the array and [source.loopback] of a configuration
chachart device espargos --config espargos-hall           the boards of all sources, on one port each

It prints what to give to `chachart-node --set`, plays until its scenario ends or Ctrl-C, and says what has
become of what it sent.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from chachart.config.load import load
from chachart.config.pairing import FeedSettings
from chachart.config.registry import source_class
from chachart.node.data.errors import SetupError
from chachart.sources.live.device import DeviceSource
from chachart.sources.live.simulated import Address, SimulatedDevice

PORTS = {"espargos": 8000, "oai": 2021, "krakensdr": 5000, "wifi": 5500}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `chachart device`."""
    parser.add_argument("device", metavar="DEVICE", help=", ".join(PORTS))
    parser.add_argument("--listen", type=_address, metavar="HOST:PORT", help="127.0.0.1 and its usual port")
    parser.add_argument(
        "--config", type=Path, metavar="TOML", help="array and loopback (default: DEVICE-loopback.toml)"
    )
    parser.add_argument(
        "--set", action="extend", nargs="+", default=[], metavar="SECTION.KEY=VALUE", help="change the config"
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Play to the end.

    Raises
    ------
    SetupError
        If there is no such device, the configuration does not fit, or the address is taken.
    """
    if arguments.device not in PORTS:
        raise SetupError(f'there is no device "{arguments.device}", only {", ".join(PORTS)}')
    settings = load(arguments.config or Path(f"{arguments.device}-loopback.toml"), arguments.set)
    host, port = arguments.listen or ("127.0.0.1", PORTS[arguments.device])
    devices: list[SimulatedDevice] = []
    asked = threading.Event()
    try:
        for feed in settings.feeds:
            devices.append(_device(feed, arguments.device, (host, port)))
            port += len(feed.arrays) if port else 0
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, lambda *_: asked.set())
        for number, device in enumerate(devices):
            device.start()
            which = f" of source.{number}" if len(devices) > 1 else ""
            print(f"{arguments.device}{which}: {device.where}", flush=True)
        while not asked.wait(0.1) and not all(device.ended.is_set() for device in devices):
            pass
    finally:
        for device in devices:
            device.stop()
    report: Counter[str] = Counter()
    for device in devices:
        report.update(asdict(device.report))
    print(json.dumps(report) if arguments.json else "\n".join(f"{key:<14} {n}" for key, n in report.items()))
    return 0


def _device(feed: FeedSettings, wanted: str, address: Address) -> SimulatedDevice:
    """The device that a source listens to."""
    cls = source_class(feed.source.type)
    if feed.source.type != wanted or not issubclass(cls, DeviceSource):
        raise SetupError(f'the configuration has a source "{feed.source.type}", not "{wanted}"')
    if not feed.arrays:
        raise SetupError("the configuration has no [array]")
    first, *others = [array.geometry() for array in feed.arrays]
    source = cls(feed.source, first)
    source.others = tuple(others)
    device = source.simulate(address)
    if device is None:
        raise SetupError("[source] loopback: must be true, or a table that says what to simulate")
    return device


def _address(text: str) -> Address:
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text} is no HOST:PORT")
    return host.strip("[]"), int(port)
