import itertools
import socket
from concurrent.futures import ThreadPoolExecutor

import can
import numpy as np
import pytest
from front_ends import ARRAY, assert_same_chart, direct, front_end, listen, origin, report, scenario
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from source_contract import SourceCase, SourceContract, receive

from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.sources.frontend.address import FrontEndAddress
from chachart.sources.frontend.can import CanSettings, CanSource
from chachart.sources.frontend.can_link import CanLink, segments
from chachart.sources.frontend.device import Report
from chachart.sources.frontend.isotp_link import IsoTpReceiver
from chachart.sources.frontend.packet import CsiPacket, SampleFormat, encode, max_packet_bytes

CHANNELS = (f"test-{n}" for n in itertools.count())
GROUP = "239.74.163.2"


def virtual(**changes) -> CanSettings:
    """A bus of its own within this process."""
    return CanSettings(interface="virtual", channel=next(CHANNELS), **changes)


def counts(source: CanSource) -> dict[str, int]:
    [front_end] = source.details()["front_ends"].values()
    return front_end


class TestContract(SourceContract):
    @pytest.fixture
    def case(self) -> SourceCase:
        table = {"interface": "virtual", "channel": next(CHANNELS), "loopback": {"scenario": scenario(200)}}
        return SourceCase("can", table, ARRAY)


@pytest.fixture
def multicast_port() -> int:
    """A free UDP port, where this machine lets processes talk by multicast at all."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    try:
        buses = [can.Bus(GROUP, "udp_multicast", ignore_config=True, port=port) for _ in range(2)]
    except (OSError, can.CanError) as error:
        pytest.skip(f"no UDP multicast here: {error}")
    try:
        buses[0].send(can.Message(arbitration_id=1, data=b"x"))
        heard = buses[1].recv(1.0)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no UDP multicast here: {error}")
    finally:
        for bus in buses:
            bus.shutdown()
    if heard is None:
        pytest.skip("no UDP multicast here: a message sent is not received")
    return port


def test_two_thousand_frames_over_can_fd_and_none_is_lost():
    with CanSource(virtual(loopback={"scenario": scenario(2000)}), ARRAY) as source:
        got = CsiBlock.concatenate(listen(source, 2000))
    assert counts(source)["lost"] == 0
    assert source.rejected.as_dict() == {}
    assert_same_chart(got, direct(2000))


def test_two_thousand_frames_between_two_processes(multicast_port):
    bus = CanSettings(interface="udp_multicast", channel=GROUP, options={"port": multicast_port})
    link = ("--can", f"udp_multicast:{GROUP}", "--option", f"port={multicast_port}")
    with CanSource(bus, ARRAY) as source, front_end(*link, frames=2000) as device:
        got = CsiBlock.concatenate(listen(source, 2000))
        assert report(device)["sent"] == 2000
    assert counts(source)["lost"] == 0
    assert_same_chart(got, direct(2000))


@pytest.mark.parametrize(("fd", "frames"), [(True, 2000), (False, 200)])
def test_damaged_and_dropped_frames_are_counted_exactly_and_cost_no_other(fd, frames):
    faults = {"corrupt": 0.01, "drop": 0.01, "fault_seed": 3}
    with CanSource(virtual(fd=fd, loopback={"scenario": scenario(frames), **faults}), ARRAY) as source:
        got = CsiBlock.concatenate(listen(source, frames))
        told = Report(**source.simulated())
    assert told.corrupted > 0
    assert told.dropped > 0
    assert told.unheard == 0
    assert len(got) == told.sent == frames - told.corrupted - told.dropped
    assert counts(source)["lost"] == told.corrupted + told.dropped
    assert len(origin(got, direct(frames))) == told.sent


def frame(seq: int, ue: int) -> bytes:
    csi = np.full((ARRAY.antennas, ARRAY.subcarriers), 1 + 1j, np.complex64)
    return encode(CsiPacket.quantise(seq, seq + 1, ue, csi, SampleFormat.INT8))


def test_several_front_ends_share_a_bus_by_their_identifiers():
    addresses = (
        FrontEndAddress(id=0x640, reply_id=0x648),
        FrontEndAddress(id=0x18DA0001, reply_id=0x18DA0100),
        FrontEndAddress(id=0x650, reply_id=0x658),
    )
    bus = virtual(front_ends=addresses[:2])
    links = [CanLink(bus, address) for address in addresses]
    blocks = []
    with CanSource(bus, ARRAY) as source, ThreadPoolExecutor(3) as threads:
        for seq in range(3):
            sending = [
                threads.submit(link.send, frame(seq * (n + 1), ue=n)) for n, link in enumerate(links[:2])
            ]
            blocks += receive(source, 2)
            assert all(done.result() for done in sending)
        links[2].stopping.set()
        assert not links[2].send(frame(0, ue=2))
        assert source.recv(0.0) is None
    for link in links:
        link.close()
    assert sorted(np.concatenate([b.ue for b in blocks]).tolist()) == [0, 0, 0, 1, 1, 1]
    lost = {name: c["lost"] for name, c in source.details()["front_ends"].items()}
    assert lost == {"0x640": 0, "0x18DA0001": 2}


def test_a_bus_that_goes_is_tried_again():
    bus = virtual(retry_max_s=0.2)
    source = CanSource(bus, ARRAY)
    source.open()
    assert source._bus is not None
    source._bus.shutdown()
    assert source.recv(0.0) is None
    assert not source.details()["connected"]
    link = CanLink(bus, FrontEndAddress())
    while not source.details()["connected"]:
        source.recv(0.1)
    assert source.details()["reconnects"] == 1
    link.close()
    source.close()


def test_an_interface_that_does_not_exist_is_said_so():
    wrong = CanSettings(interface="socketcann")
    [problem] = CanSource.problems(wrong)
    assert "socketcan," in problem
    with pytest.raises(SetupError, match="socketcann"):
        CanSource(wrong, ARRAY).open()


def test_a_channel_that_does_not_exist_is_said_so():
    with pytest.raises(SetupError, match=r'CAN channel "no-such" of interface "socketcan" cannot be opened'):
        CanSource(CanSettings(interface="socketcan", channel="no-such"), ARRAY).open()


@pytest.mark.parametrize(
    "front_ends",
    [[], [{"id": 1, "reply_id": 1}], [{"id": 1}, {"id": 2}], [{"id": 0x800, "reply_id": 1}], [{"id": -1}]],
)
def test_addresses_that_cannot_be_told_apart_are_refused(front_ends):
    with pytest.raises(ValidationError):
        CanSettings(front_ends=front_ends)


@pytest.mark.parametrize(("length", "fd", "n"), [(7, False, 1), (8, False, 2), (62, True, 1), (63, True, 2)])
def test_messages_a_packet_takes(length, fd, n):
    assert segments(length, fd) == n


MESSAGE = st.builds(
    can.Message,
    arbitration_id=st.sampled_from([0x640, 0x641]),
    data=st.one_of(
        st.binary(max_size=8),
        st.sampled_from([12, 16, 20, 24, 32, 48, 64]).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    ),
    is_extended_id=st.booleans(),
    is_error_frame=st.booleans(),
)


@given(st.lists(MESSAGE, max_size=30), st.booleans())
def test_any_messages_leave_the_receiver_ready_and_small(messages, silent):
    rejected = Counters()
    limit = max_packet_bytes(2, 2)
    replies: list[object] = []
    send = None if silent else replies.append
    receiver = IsoTpReceiver((FrontEndAddress(),), limit, rejected, send, fd=True)
    [end] = receiver._ends.values()
    for at_once in (messages[:9], *([m] for m in messages[9:])):
        assert all(len(packet) <= limit for _, packet in receiver.feed(at_once))
        assert len(end.layer.rx_buffer) <= limit
        assert not end.waiting
    whole = [b"\x10\x0a123456", b"\x217890"]
    packets = receiver.feed(can.Message(arbitration_id=0x640, data=d, is_extended_id=False) for d in whole)
    assert packets == [("0x640", b"1234567890")]
    assert len(replies) <= len(messages) + 1
