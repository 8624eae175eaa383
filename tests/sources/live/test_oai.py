"""The source `oai` with a simulated gNB at the other end of a real socket."""

from __future__ import annotations

import socket
import threading
from typing import Any

import numpy as np
import pytest
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.live.oai.gnb import SimulatedGnb
from chachart.sources.live.oai.source import OaiLoopback, OaiSettings, OaiSource
from chachart.sources.simulator import Simulator, SimulatorSettings

ARRAY = ArrayGeometry("gnb", 4, 16, 3.6e9, 480_000.0, 0.0416)


def scenario(**changes: Any) -> SimulatorSettings:
    return SimulatorSettings.model_validate({"ues": 8, "frame_rate_hz": 0.0, "snr_db": 200.0, **changes})


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> SourceCase:
        loopback = {"scenario": {"ues": 8, "frame_rate_hz": 500.0, "snr_db": 20.0}}
        return SourceCase("oai", {"loopback": loopback}, ARRAY)


def test_frames_are_what_was_sounded() -> None:
    loopback = OaiLoopback(scenario=scenario(frames=100))
    with OaiSource(OaiSettings(loopback=loopback), ARRAY) as source:
        blocks = receive(source, 10_000)
    with Simulator(scenario(frames=8), ARRAY) as simulator:
        block = simulator.recv(10.0)
        assert block is not None
        truth = block.csi
    csi = np.concatenate([b.csi for b in blocks])
    ues = np.concatenate([b.ue for b in blocks]).astype(int)
    assert len(csi) == 100
    scale = np.abs(truth[ues]).max(axis=(1, 2), keepdims=True) / np.abs(csi).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(csi * scale, truth[ues], atol=2e-4 * np.abs(truth).max())


def test_what_is_lost_or_cut_is_counted_exactly() -> None:
    loopback = OaiLoopback(scenario=scenario(frames=3000), drop=0.02, corrupt=0.02)
    with OaiSource(OaiSettings(loopback=loopback), ARRAY) as source:
        blocks = receive(source, 10_000)
        assert isinstance(source.simulated, SimulatedGnb)
        report, rejected = source.simulated.report, source.rejected.as_dict()
    assert min(report.dropped, report.corrupted) > 20
    assert sum(len(b) for b in blocks) == report.sent
    assert rejected["buffer"] == report.corrupted
    assert sum(len(b) for b in blocks) + report.dropped + report.corrupted == 3000


def test_tones_that_are_no_multiple_are_told() -> None:
    array = ArrayGeometry("gnb", 4, 16, 3.6e9, 100_000.0, 0.0416)
    with pytest.raises(SetupError, match="must be a multiple of the gNB's 30000 Hz"):
        OaiSource(OaiSettings(loopback=True), array).open()


def test_nobody_there_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(SetupError, match="no T tracer answers"):
        OaiSource(OaiSettings(port=port), ARRAY).open()


def test_somebody_who_speaks_otherwise_is_left_and_tried_again() -> None:
    said = threading.Event()

    def speak(listener: socket.socket) -> None:
        client, _ = listener.accept()
        with client:
            client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            said.wait(10)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=speak, args=(listener,))
        thread.start()
        settings = OaiSettings(port=listener.getsockname()[1], retry_max_s=0.1)
        try:
            with OaiSource(settings, ARRAY) as source:
                assert source.recv(2.0) is None
                assert source.rejected.as_dict() == {"length": 1}
                assert source.details()["reconnects"] == 1
        finally:
            said.set()
            thread.join()
