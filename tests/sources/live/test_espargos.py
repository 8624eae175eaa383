"""The source `espargos` with simulated boards at the other end of real sockets."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from source_contract import SourceCase, SourceContract

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource
from chachart.sources.live.espargos.board import BoardFaults
from chachart.sources.live.espargos.control import Channel
from chachart.sources.live.espargos.far_end import NetworkBoard, SerialBoard
from chachart.sources.live.espargos.message import TONES
from chachart.sources.live.espargos.settings import Board, EspargosLoopback, EspargosSettings
from chachart.sources.live.espargos.source import EspargosSource
from chachart.sources.simulator import Simulator, SimulatorSettings

ARRAY = ArrayGeometry("board", 8, 25, 2.472e9, 625_000.0, 0.06)


def scenario(**changes: Any) -> SimulatorSettings:
    values = {"ues": 16, "frame_rate_hz": 400.0, "snr_db": 200.0}
    return SimulatorSettings.model_validate({**values, **changes})


def heard(source: EspargosSource) -> list[CsiBlock]:
    """All blocks until the board has played to its end."""
    blocks, deadline = [], time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            block = source.recv(0.2)
        except EndOfSource:
            return blocks
        if block is not None:
            blocks.append(block)
    raise AssertionError("the board did not end")


def likeness(blocks: list[CsiBlock]) -> np.ndarray:
    """Of each frame to what its UE's channel is, 1 for equal, whatever the packet's own phase and delay."""
    with Simulator(scenario(frame_rate_hz=0.0), ARRAY) as simulator:
        truth = np.concatenate([b.csi for _ in range(2) if (b := simulator.recv(10.0)) is not None])[:16]
    ratio = np.concatenate([b.csi * truth[b.ue.astype(int)].conj() for b in blocks])
    power = np.concatenate([np.abs(b.csi) ** 2 for b in blocks]).sum(axis=(1, 2))
    lag = (ratio[:, :, 1:] * ratio[:, :, :-1].conj())[:, :, np.diff(TONES) == 2].sum(axis=(1, 2))
    flat = ratio * np.exp(-0.5j * np.angle(lag)[:, None, None] * TONES)
    ues = np.concatenate([b.ue for b in blocks]).astype(int)
    return np.abs(flat.sum(axis=(1, 2))) / np.sqrt(power * (np.abs(truth[ues]) ** 2).sum(axis=(1, 2)))


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> SourceCase:
        loopback = {"scenario": {"ues": 8, "frame_rate_hz": 500.0, "snr_db": 20.0}}
        return SourceCase("espargos", {"loopback": loopback, "calibrate_s": 0.0}, ARRAY)


def test_frames_are_coherent_over_the_antennas_after_calibration() -> None:
    loopback = EspargosLoopback(scenario=scenario(frames=200))
    with EspargosSource(EspargosSettings(loopback=loopback, calibrate_s=0.3), ARRAY) as source:
        blocks = heard(source)
        details = source.details()
    assert details["calibration"] == "done"
    assert details["calibration_packets"] >= 8
    assert likeness(blocks).min() > 0.999999


def test_without_calibration_they_are_not() -> None:
    loopback = EspargosLoopback(scenario=scenario(frames=50))
    with EspargosSource(EspargosSettings(loopback=loopback, calibrate_s=0.0), ARRAY) as source:
        assert likeness(heard(source)).max() < 0.9


def test_what_is_lost_or_damaged_on_the_way_is_counted_exactly() -> None:
    loopback = EspargosLoopback(
        scenario=scenario(frames=1000, frame_rate_hz=250.0), corrupt=0.03, drop=0.03, reorder=0.05
    )
    with EspargosSource(EspargosSettings(loopback=loopback, calibrate_s=0.2), ARRAY) as source:
        blocks = heard(source)
        assert isinstance(source.simulated, NetworkBoard)
        report = source.simulated.report
        rejected = source.rejected.as_dict()
    assert min(report.dropped, report.corrupted, report.reordered) > 10
    early = rejected.get("calibrating", 0)
    assert sum(len(b) for b in blocks) + early == report.sent
    assert rejected["crc"] + rejected.get("truncated", 0) + rejected.get("fields", 0) == report.corrupted
    assert likeness(blocks).min() > 0.999999


def test_a_board_that_goes_and_comes_back_is_found_again() -> None:
    first = NetworkBoard(Simulator(scenario(frames=40), ARRAY), Channel(6, 0), BoardFaults())
    first.start()
    settings = EspargosSettings(
        boards=(Board(host=first.host),), udp_port=first.udp_port, calibrate_s=0.0, retry_max_s=0.2
    )
    try:
        with EspargosSource(settings, ARRAY) as source:
            assert source.recv(5.0) is not None
            assert source.details()["connected"]
    finally:
        first.stop()
    with pytest.raises(SetupError, match="does not answer"):
        EspargosSource(settings, ARRAY).open()


def test_somebody_else_at_the_address_is_told() -> None:
    board = NetworkBoard(Simulator(scenario(), ARRAY), Channel(6, 0), BoardFaults())
    board.start()
    try:
        wrong = ArrayGeometry("board", 4, 25, 2.472e9, 625_000.0, 0.06)
        settings = EspargosSettings(boards=(Board(host=board.host),), udp_port=board.udp_port)
        with pytest.raises(SetupError, match="8 antennas x 25 subcarriers, not 4 x 25"):
            EspargosSource(settings, wrong).open()
    finally:
        board.stop()


def test_a_board_named_twice_is_a_problem() -> None:
    settings = EspargosSettings(boards=(Board(), Board()))
    assert EspargosSource.problems(settings) == ["boards: '192.168.1.2' stands there twice"]


def test_a_board_on_a_serial_line_is_the_same() -> None:
    board = SerialBoard(
        Simulator(scenario(frames=100, frame_rate_hz=200.0), ARRAY), Channel(13, 0), BoardFaults()
    )
    board.start()
    settings = EspargosSettings(boards=(Board(serial_port=board.port),), calibrate_s=0.5)
    blocks: list[CsiBlock] = []
    try:
        with EspargosSource(settings, ARRAY) as source:
            deadline = time.monotonic() + 30
            while not board.ended.is_set() and time.monotonic() < deadline:
                block = source.recv(0.1)
                blocks += [] if block is None else [block]
            while (block := source.recv(0.3)) is not None:
                blocks.append(block)
            assert source.details()["calibration"] == "done"
            assert sum(len(b) for b in blocks) + source.rejected.as_dict().get("calibrating", 0) == 100
    finally:
        board.stop()
    assert likeness(blocks).min() > 0.999999


def test_a_serial_line_without_a_board_is_told() -> None:
    settings = EspargosSettings(boards=(Board(serial_port="/dev/nothing"),))
    with pytest.raises(SetupError, match="cannot be opened"):
        EspargosSource(settings, ARRAY).open()
