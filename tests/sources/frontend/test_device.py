import os
import threading
import tty

import numpy as np
import pytest
from front_ends import ARRAY, scenario

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.frontend.device import FaultSettings, Link, SimulatedFrontEnd, damaged
from chachart.sources.frontend.framing import StreamDecoder, encode_frame
from chachart.sources.frontend.packet import CsiPacket, Heartbeat, Hello, decode
from chachart.sources.frontend.serial_link import PortLink
from chachart.sources.simulator import Simulator, SimulatorSettings


class Wire(Link):
    """A line that keeps what is put on it; nobody hears what is sent while it is unplugged."""

    def __init__(self) -> None:
        super().__init__()
        self.packets = []
        self.spoiled = 0
        self.plugged = True
        self.connections = 1

    where = "wire"

    def wait_ready(self, timeout):
        return self.plugged

    def send(self, packet, damage=None):
        if damage is not None:
            self.spoiled += 1
        elif self.plugged:
            self.packets.append(decode(packet))
        return self.plugged

    def unplug(self):
        self.plugged = False

    def plug(self):
        self.plugged = True
        self.connections += 1

    def close(self):
        self.plugged = False


def played(frames: int, **faults) -> tuple[Wire, SimulatedFrontEnd]:
    wire = Wire()
    source = Simulator(SimulatorSettings(**scenario(frames)), ARRAY)
    device = SimulatedFrontEnd(source, wire, FaultSettings(**faults))
    device.run()
    return wire, device


def sequence(wire: Wire) -> list[int]:
    return [p.seq for p in wire.packets if isinstance(p, CsiPacket)]


def test_it_says_who_it_is_before_anything_else_and_how_many_frames_there_were_last():
    wire, _ = played(100)
    assert wire.packets[0] == Hello(
        0, 0, ARRAY.antennas, ARRAY.subcarriers, 2e9, 312_500.0, np.float32(ARRAY.element_spacing_m), "SIM-1"
    )
    assert isinstance(wire.packets[-1], Heartbeat)
    assert wire.packets[-1].seq == 100
    assert sequence(wire) == list(range(100))


def test_its_clock_starts_with_its_first_frame():
    wire, _ = played(100)
    times = [p.time_ns for p in wire.packets if isinstance(p, CsiPacket)]
    assert times[0] == 1
    assert (np.diff(times) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_every_frame_is_accounted_for_once(seed):
    wire, device = played(1000, drop=0.1, corrupt=0.1, reorder=0.1, fault_seed=seed)
    report = device.report
    assert report.arriving + report.lost == 1000
    assert len(sequence(wire)) == report.arriving
    assert wire.spoiled == report.corrupted > 0
    assert report.dropped > 0
    late = np.maximum.accumulate(sequence(wire)) - sequence(wire)
    assert np.count_nonzero(late) <= report.reordered
    assert 0 < late.max() <= 9


class Counting(Source):
    """A live source of one frame a call."""

    Settings = SourceSettings

    def __init__(self) -> None:
        super().__init__(None, ARRAY)
        self.given = 0

    def open(self):
        """Nothing to open."""

    def recv(self, timeout):
        if self.given == 300:
            raise EndOfSource
        self.given += 1
        csi = np.ones((1, ARRAY.antennas, ARRAY.subcarriers), np.complex64)
        return CsiBlock("lab", self.given, np.ones(1, np.uint64), np.array([self.given]), csi)


def test_frames_of_a_live_source_are_lost_while_it_is_unplugged():
    ticks = iter(range(10**6))
    wire = Wire()
    settings = FaultSettings(unplug_every_s=100.0, unplugged_s=20.0)
    device = SimulatedFrontEnd(Counting(), wire, settings, lambda: float(next(ticks)))
    report = device.run()
    assert report.sent + report.unplugged == 300
    assert report.unplugged > 20
    assert len(sequence(wire)) == report.sent
    assert sum(isinstance(p, Hello) for p in wire.packets) >= wire.connections > 1


def test_damage_is_damage():
    rng = np.random.default_rng(6)
    rejected = Counters()
    decoder = StreamDecoder(100, rejected)
    wire = encode_frame(b"0123456789" * 4)
    for _ in range(2000):
        spoiled = damaged(wire, rng)
        assert spoiled != wire
        assert (spoiled[0], spoiled[-1]) == (0, 0)
        assert b"0123456789" * 4 not in decoder.feed(spoiled)


def test_a_real_port_carries_the_same_bytes():
    master, other = os.openpty()
    tty.setraw(other)
    link = PortLink(os.ttyname(other), 115_200)
    assert link.where == os.ttyname(other)
    os.close(other)
    assert link.wait_ready(0.0)
    packet = bytes(range(256)) * 8
    sender = threading.Thread(target=link.send, args=(packet,))
    sender.start()
    decoder, got = StreamDecoder(4096, Counters()), []
    while not got:
        got = decoder.feed(os.read(master, 500))
    sender.join()
    assert got == [packet]
    link.unplug()
    assert not link.wait_ready(0.0)
    assert not link.send(packet)
    link.close()
    os.close(master)
