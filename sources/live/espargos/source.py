"""The source `espargos`: live frames from one ESPARGOS board, or from several that share a clock."""

from __future__ import annotations

import logging
import select
import time
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from chachart.node.data.counters import Counters
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import SourceSettings
from chachart.sources.frontend.clock import DeviceClock
from chachart.sources.live.device import (
    CodecError,
    Connection,
    DeviceGone,
    DeviceSource,
    Frame,
    count,
)
from chachart.sources.live.espargos import calibration, control, stream
from chachart.sources.live.espargos.board import Wiring
from chachart.sources.live.espargos.calibration import Correction, trace_delay_s
from chachart.sources.live.espargos.cluster import ANTENNAS, Cluster, Grouping
from chachart.sources.live.espargos.control import Channel
from chachart.sources.live.espargos.far_end import NetworkBoard, WiredBoards
from chachart.sources.live.espargos.link import Link, NetworkLink
from chachart.sources.live.espargos.message import TONES, decode_message
from chachart.sources.live.espargos.serial_link import SerialLink
from chachart.sources.live.espargos.settings import Board, EspargosLoopback, EspargosSettings
from chachart.sources.live.simulated import ANY_PORT, Address, SimulatedDevice
from chachart.sources.simulator import Simulator

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 1.0
SILENCE_S = 5.0
PATIENCE = 4.0
"""Where too few reference packets have come, they are waited for so many times as long again."""


class EspargosSource(DeviceSource):
    """One Wi-Fi packet that all antennas heard is a frame; its sender is the UE."""

    Settings: ClassVar[type[SourceSettings]] = EspargosSettings
    facts = CaptureFacts(phase="random", delay="relative", power="agc")
    settings: EspargosSettings

    @classmethod
    def problems(cls, settings: EspargosSettings) -> list[str]:
        """Boards named twice."""
        hosts = [board.host for board in settings.boards]
        return [
            f"boards: {host!r} stands there twice" for host in dict.fromkeys(hosts) if hosts.count(host) > 1
        ]

    @property
    def where(self) -> str:
        """The boards' addresses."""
        return (
            "loopback" if self.settings.loopback else ", ".join(board.host for board in self.settings.boards)
        )

    def simulate(self, address: Address = ANY_PORT) -> SimulatedDevice | None:
        """See `DeviceSource`."""
        told = self.settings.loopback
        if not told:
            return None
        loopback = told if isinstance(told, EspargosLoopback) else EspargosLoopback()
        channel = Channel(loopback.channel_primary, 0)
        wired, first = self.settings.boards, Wiring()
        self._check_array(len(wired))
        boards = []
        for number, (board, array) in enumerate(zip(wired, self._board_arrays(), strict=True)):
            wiring = replace(first, number=number, cable_s=board.cable_s)
            at = (address[0], address[1] + number if address[1] else 0)
            hears = Simulator(loopback.scenario, array)
            boards.append(NetworkBoard(hears, channel, loopback, at, wiring))
        return boards[0] if len(boards) == 1 else WiredBoards(boards)

    def _board_arrays(self) -> list[ArrayGeometry]:
        """What each board is an array of its own, however its antennas are put together to arrays."""
        arrays = []
        for array in (self.array, *self.others):
            if array.antennas == ANTENNAS:
                arrays.append(array)
                continue
            places = np.asarray(array.own_elements if array.elements is None else array.elements)
            band = array.subcarriers, array.carrier_hz, array.subcarrier_spacing_hz
            pose = {name: getattr(array, name) for name in ("position_m", "axis", "broadside", "tones")}
            for start in range(0, len(places), ANTENNAS):
                part = places[start : start + ANTENNAS]
                arrays.append(ArrayGeometry.of_elements(array.name, part, *band, **pose))
        return arrays

    def _connect(self) -> Connection:
        boards, port = self.settings.boards, self.settings.udp_port
        simulated = self.simulated
        if simulated is not None:
            far_ends = simulated.boards if isinstance(simulated, WiredBoards) else [simulated]
            hosts = [end.host for end in far_ends if isinstance(end, NetworkBoard)]
            boards = tuple(b.model_copy(update={"host": h}) for b, h in zip(boards, hosts, strict=True))
        self._check_array(len(boards))
        links = [self._link(board, port) for board in boards]
        cables = np.array([board.cable_s for board in boards])
        return Stream(links, cables, self.settings.calibrate_s, self.rejected)

    def _link(self, board: Board, udp_port: int) -> Link:
        if board.serial_port is not None:
            return SerialLink(board.serial_port, board.baudrate, self.rejected)
        return NetworkLink(board.host, udp_port, self.rejected)

    def _check_array(self, boards: int) -> None:
        wanted = boards * ANTENNAS, len(TONES)
        arrays = (self.array, *self.others)
        there = sum(array.antennas for array in arrays), self.array.subcarriers
        if there != wanted or any(array.antennas % ANTENNAS for array in arrays):
            raise SetupError(
                f"[array] {boards} ESPARGOS boards measure {wanted[0]} antennas x {wanted[1]} subcarriers, "
                f"not {there[0]} x {there[1]}"
            )


class Stream(Connection):
    """The sensor packets of all boards, their calibration, and the frames that come of them.

    Parameters
    ----------
    links
        The ways to the boards.
    cables_s
        Delay (boards,) of the cable that brings each board the common reference.
    calibrate_s
        How long the reference is listened to.
    rejected
        Where what was not understood or not whole is counted.

    Raises
    ------
    SetupError
        If a controller does not answer or does not begin to send.
    """

    def __init__(
        self, links: list[Link], cables_s: NDArray[np.float64], calibrate_s: float, rejected: Counters
    ) -> None:
        self._links = links
        self._path_s = (trace_delay_s() + cables_s[:, None]).ravel()
        self._calibrate_s, self._rejected = calibrate_s, rejected
        self._grouping = Grouping(ANTENNAS * len(links), rejected)
        self._reassembly = [stream.Reassembly(rejected) for _ in links]
        self._clock = DeviceClock()
        self._correction: Correction | None = None
        self._references: list[Cluster] = []
        self._calibrating = False
        self._calibrated_at: float | None = None
        try:
            self._channel = self._begin()
        except SetupError:
            self.close()
            raise

    def frames(self, timeout: float) -> list[Frame] | None:
        """See `Connection`."""
        now = time.monotonic()
        self._keep_alive(now)
        self._calibrate(now)
        readable = select.select(self._links, [], [], min(timeout, KEEP_ALIVE_S))[0]
        frames: list[Frame] = []
        for board, link in enumerate(self._links):
            if link in readable:
                self._heard = time.monotonic()
                for _ in range(ANTENNAS):  # a Wi-Fi packet's worth, then look at the other boards
                    packets = link.packets()
                    frames += [frame for packet in packets for frame in self._take(board, packet)]
                    if not packets:
                        break
        if not readable and time.monotonic() - self._heard > SILENCE_S:
            raise DeviceGone(f"nothing for {SILENCE_S:g} s")
        return frames if readable else None

    def close(self) -> None:
        """Have the controllers stop."""
        for link in self._links:
            link.close()

    def details(self) -> dict[str, Any]:
        """The channel, and what calibration has found."""
        found = self._correction
        state = "running" if self._calibrating else "none" if found is None else "done"
        return {
            "channel": self._channel.primary,
            "secondary": self._channel.secondary,
            "calibration": state,
            "calibration_packets": 0 if found is None else found.packets,
            "clock": self._clock.details(),
        }

    def _begin(self) -> Channel:
        """Ask all boards to send, and wait until each does."""
        channels = set()
        for link in self._links:
            link.identify()
            link.acquire()
            channels.add(link.channel())
        if len(channels) > 1:
            raise SetupError(
                f"[source] the boards listen on different channels: {sorted(c.primary for c in channels)}"
            )
        for link in self._links:
            link.begin()
        self._heard = self._kept_alive = time.monotonic()
        if self._calibrate_s:
            self._start_calibration()
        return channels.pop()

    def _keep_alive(self, now: float) -> None:
        if now - self._kept_alive < KEEP_ALIVE_S:
            return
        self._kept_alive = now
        for link in self._links:
            link.keep_alive()
        self._grouping.give_up(now)

    def _start_calibration(self) -> None:
        self._references = []
        for link in self._links:
            link.switch(control.REFERENCE)
        self._calibrating, self._calibrated_at = True, None

    def _calibrate(self, now: float) -> None:
        """When the reference has been heard for long enough: find the correction, back to the antennas."""
        if not self._calibrating:
            return
        if self._calibrated_at is None:  # from when somebody reads, which may be long after the connection
            self._calibrated_at = now + self._calibrate_s
        late = now - self._calibrated_at
        few = len(self._references) < calibration.FEWEST
        if late < 0 or (few and late < PATIENCE * self._calibrate_s):
            return
        self._calibrating = False
        try:
            for link in self._links:
                link.switch(control.ANTENNAS)
        except SetupError as error:
            raise DeviceGone(str(error)) from None
        if few:
            log.warning(
                "%s: only %d reference packets came: frames are not calibrated (is the phase reference "
                "generated during calibration? see the controller's web page)",
                self._links[0].name,
                len(self._references),
            )
            return
        self._correction = calibration.find(self._references, self._channel.centre_hz, self._path_s)
        log.info("calibrated by %d reference packets", self._correction.packets)

    def _take(self, board: int, datagram: bytes) -> list[Frame]:
        if datagram in (b"", stream.HELLO):
            return []
        frames: list[Frame] = []
        now = time.monotonic()
        try:
            for fragment in stream.decode_packet(datagram):
                whole = self._reassembly[board].add(fragment, now)
                sensor = None if whole is None else decode_message(whole)
                if sensor is not None:
                    cluster = self._grouping.add(ANTENNAS * board + fragment.antenna, sensor, now)
                    if cluster is not None:
                        frames += self._frame(cluster)
        except CodecError as error:
            count(error, self._rejected)
        return frames

    def _frame(self, cluster: Cluster) -> list[Frame]:
        """The frame in a packet; reference packets are kept for the calibration."""
        first = cluster.first
        heard_on = Channel(first.channel, first.secondary)
        if heard_on != self._channel:
            log.info("the channel is now %d: calibrating anew", first.channel)
            self._channel = heard_on
            if self._calibrate_s:
                self._start_calibration()
        if first.calibration:
            if self._calibrating:
                self._references.append(cluster)
            return []
        if self._calibrating:
            self._rejected.add("calibrating")
            return []
        csi = cluster.aligned()
        if self._correction is not None:
            csi = csi * self._correction.factor
        time_ns = self._clock.observe(first.time_half_ns // 2, time.time_ns())
        packet = 1 + (first.sequence << 1 | first.retry)
        return [Frame(first.source, time_ns, csi, packet)]
