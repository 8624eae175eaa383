import os
import socket
import time

import numpy as np
import pytest
from front_ends import ARRAY, assert_same_chart, direct, front_end, listen, origin, report, scenario
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.frontend.framing import encode_frame
from chachart.sources.frontend.packet import CsiPacket, SampleFormat, encode
from chachart.sources.frontend.serial import SerialSettings, SerialSource
from chachart.sources.frontend.serial_link import PtyLink


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> SourceCase:
        return SourceCase("serial", {"loopback": {"scenario": scenario(200)}}, ARRAY)


class TestContractOfAPort(SourceContract):
    """The same with a device that the test plays by hand."""

    @pytest.fixture
    def case(self, tmp_path):
        link = PtyLink(tmp_path / "port")
        sent = iter(range(10**6))

        def feed(source):
            if link.wait_ready(1.0):
                assert link.send(frame(next(sent)))

        yield SourceCase("serial", {"port": link.where}, ARRAY, feed)
        link.close()


def frame(seq: int) -> bytes:
    csi = np.full((ARRAY.antennas, ARRAY.subcarriers), 1 + 1j, np.complex64)
    return encode(CsiPacket.quantise(seq, seq + 1, 7, csi, SampleFormat.INT8))


def listener(port: str, **settings) -> SerialSource:
    return SerialSource(SerialSettings(port=port, **settings), ARRAY)


def counts(source: SerialSource) -> dict[str, int]:
    [front_end] = source.details()["front_ends"].values()
    return front_end


def test_ten_thousand_frames_from_another_process_and_none_is_lost(tmp_path):
    port = str(tmp_path / "port")
    with front_end("--serial", f"pty:{port}", frames=10_000) as device, listener(port) as source:
        blocks = listen(source, 10_000)
        assert report(device)["sent"] == 10_000
    assert counts(source)["lost"] == 0
    assert source.rejected.as_dict() == {}
    assert_same_chart(CsiBlock.concatenate(blocks), direct(10_000))


def test_damaged_and_dropped_frames_are_counted_exactly_and_cost_no_other(tmp_path):
    port = str(tmp_path / "port")
    faults = ("--corrupt", "0.01", "--drop", "0.01")
    with front_end("--serial", f"pty:{port}", *faults, frames=10_000) as device, listener(port) as source:
        got = CsiBlock.concatenate(listen(source, 10_000))
        told = report(device)
    assert told["corrupted"] > 50
    assert told["dropped"] > 50
    assert len(got) == told["sent"] == 10_000 - told["corrupted"] - told["dropped"]
    assert counts(source)["lost"] == told["corrupted"] + told["dropped"]
    assert source.rejected.total() >= told["corrupted"]
    assert set(source.rejected.as_dict()) <= {"cobs", "crc", "short", "oversize"}
    assert len(origin(got, direct(10_000))) == told["sent"]


def test_frames_out_of_order_are_all_taken():
    loopback = {"scenario": scenario(2000), "reorder": 0.05}
    with SerialSource(SerialSettings(loopback=loopback), ARRAY) as source:
        got = listen(source, 2000)
        assert sum(len(b) for b in got) == 2000
        assert counts(source)["lost"] == 0
        assert counts(source)["reordered"] > 50


def test_unplugging_is_survived_and_costs_nothing_that_was_sent():
    loopback = {"scenario": scenario(3000), "unplug_every_frames": 1000, "unplugged_s": 0.05}
    with SerialSource(SerialSettings(loopback=loopback, retry_max_s=0.2), ARRAY) as source:
        got = listen(source, 3000)
        assert sum(len(b) for b in got) == 3000
        assert source.details()["reconnects"] >= 1
        assert counts(source)["restarts"] == 0


def test_what_a_live_device_measured_while_unplugged_is_counted_as_lost():
    playing = {**scenario(2000), "frame_rate_hz": 2000.0}
    loopback = {"scenario": playing, "unplug_every_frames": 500, "unplugged_s": 0.2}
    with SerialSource(SerialSettings(loopback=loopback, retry_max_s=0.2), ARRAY) as source:
        got = listen(source, 2000)
        assert counts(source)["lost"] == 2000 - sum(len(b) for b in got) > 0


def test_it_finds_back_after_noise_and_half_a_packet(tmp_path):
    link = PtyLink(tmp_path / "port")
    with listener(link.where) as source:
        assert link.wait_ready(5.0)
        wire = [encode_frame(frame(n)) for n in range(4)]
        stream = b"\x55\xaa" * 500 + wire[0] + wire[1][:50] + wire[2] + b"\0\0\0" + wire[3]
        assert os.write(link._master, stream) == len(stream)
        got = receive(source, 3)
        assert sum(len(b) for b in got) == 3
    assert counts(source)["lost"] == 1
    assert source.rejected.as_dict() == {"oversize": 1, "cobs": 1}
    link.close()


def test_a_port_that_is_not_there_is_said_so(tmp_path):
    settings = SerialSettings(port=str(tmp_path / "nothing"))
    [problem] = SerialSource.problems(settings)
    assert "no such device" in problem
    with pytest.raises(SetupError, match=r"nothing.*cannot be opened"):
        SerialSource(settings, ARRAY).open()


def test_a_port_in_use_is_said_so(tmp_path):
    link = PtyLink(tmp_path / "port")
    with listener(link.where), pytest.raises(SetupError, match=r"port.*cannot be opened.*lock"):
        listener(link.where).open()
    link.close()


def test_a_serial_server_on_the_network_will_do():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = listener(f"socket://127.0.0.1:{server.getsockname()[1]}")
        assert SerialSource.problems(source.settings) == []
        with source:
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"".join(encode_frame(frame(n)) for n in range(20)))
                assert sum(len(b) for b in receive(source, 20)) == 20


def test_what_cannot_be_waited_for_is_refused():
    with pytest.raises(SetupError, match="cannot be opened"):
        listener("loop://").open()


def test_a_device_that_is_gone_is_tried_less_and_less_often(tmp_path):
    link = PtyLink(tmp_path / "port")
    with listener(link.where, retry_max_s=0.2) as source:
        link.unplug()
        assert source.recv(0.6) is None
        assert not source.details()["connected"]
        link.plug()
        deadline = time.monotonic() + 20
        while not source.details()["connected"] and time.monotonic() < deadline:
            source.recv(0.05)
        assert source.details()["reconnects"] == 1
        assert link.wait_ready(5.0)
        assert link.send(frame(0))
        assert receive(source, 1)
    link.close()
