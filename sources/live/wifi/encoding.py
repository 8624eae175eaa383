"""Frames as Wi-Fi tools write them: what a simulated tool sends. One stream, 20 MHz."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from chachart.sources.live.wifi import openwifi

DESTINATION = b"\xff" * 6
_CHANNEL = 36
_CHANSPEC_20_MHZ = 0xD000 | _CHANNEL
_HEADER_FEITCSI = 272
_RATE_HT_20_MHZ = 2 << 8
_CSI, _PAYLOAD = 0xBB, 0xC1


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """A Wi-Fi packet as a card hears it.

    Attributes
    ----------
    number, sender, time_us
        Its sequence number, its sender's address as a number, the card's clock.
    rssi_dbm
        Received power.
    csi
        complex (antennas, subcarriers of the tool, ascending), within the tool's `FULL_SCALE`.
    """

    number: int
    sender: int
    time_us: int
    rssi_dbm: int
    csi: NDArray[np.complex128]

    @property
    def address(self) -> bytes:
        """The sender's."""
        return self.sender.to_bytes(6, "big")


Encode = Callable[[Packet], list[bytes]]
"""The datagrams, or pieces of a stream, of a packet."""


def nexmon(packet: Packet) -> list[bytes]:
    """A UDP payload for each core; 64 words in the order of the FFT."""
    sequence = packet.number % 4096 << 4
    found = []
    for core, row in enumerate(packet.csi):
        head = struct.pack("<HbB", 0x1111, packet.rssi_dbm, 0x88) + packet.address
        head += struct.pack("<HHHH", sequence, core, _CHANSPEC_20_MHZ, 0x65)
        found.append(head + _pairs(np.fft.ifftshift(row), "<i2"))
    return found


def nexmon_pcap(packet: Packet) -> list[bytes]:
    """Packets of a pcap file, the first with the file's head."""
    head = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1) if packet.number == 0 else b""
    found = []
    for payload in nexmon(packet):
        datagram = struct.pack(">HHHH", 5500, 5500, 8 + len(payload), 0) + payload
        size, ones = 20 + len(datagram), b"\xff\xff\xff\xff"
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, size, 0, 0, 1, 17, 0, b"\n\n\n\n", ones)
        frame = DESTINATION + b"NEXMON" + b"\x08\0" + ip + datagram
        found.append(struct.pack("<IIII", *divmod(packet.time_us, 10**6), len(frame), len(frame)) + frame)
    return [head + b"".join(found)]


def feitcsi(packet: Packet) -> list[bytes]:
    """A record of one HT packet."""
    antennas, count = packet.csi.shape
    values = _pairs(packet.csi, "<i2")
    head = bytearray(_HEADER_FEITCSI)
    struct.pack_into("<I", head, 0, len(values))
    struct.pack_into("<BB", head, 46, antennas, 1)
    each = -packet.rssi_dbm + round(10 * np.log10(antennas))
    struct.pack_into("<IxxxxII6s", head, 52, count, each, each if antennas > 1 else 0, packet.address)
    struct.pack_into("<II", head, 88, packet.time_us % (1 << 32), _RATE_HT_20_MHZ)
    return [bytes(head) + values]


def intel5300(packet: Packet) -> list[bytes]:
    """A record of the packet, so that its sender is known, and one of its CSI."""
    antennas, groups = packet.csi.shape
    pairs = np.rint(np.stack([packet.csi.real, packet.csi.imag], -1)).astype(np.int64)
    whole = at = 0
    for group in range(groups):
        at += 3
        for value in pairs[:, group].ravel().tolist():
            whole |= (value & 0xFF) << at
            at += 8
    csi = whole.to_bytes(-(-at // 8), "little")
    rssi = [packet.rssi_dbm + 44 + 40 - round(10 * np.log10(antennas))] * antennas + [0] * (3 - antennas)
    chosen = 0b100100
    head = struct.pack(
        "<IHHBBBBBbBBHH", packet.time_us % (1 << 32), packet.number % 65536, 0, antennas, 1,
        *rssi, -92, 40, chosen, len(csi), 0x1101,
    )  # fmt: skip
    sent = (b"\x88\0\0\0" + DESTINATION + packet.address).ljust(24, b"\0")
    return [_record(_PAYLOAD, sent) + _record(_CSI, head + csi)]


def esp32(packet: Packet) -> list[bytes]:
    """A line of esp-csi: L-LTF, 64 values of 8 bits, imaginary part first."""
    values = np.fft.ifftshift(packet.csi[0])
    numbers = np.rint(np.stack([values.imag, values.real], -1)).astype(int).ravel().tolist()
    mac = ":".join(f"{octet:02X}" for octet in packet.address)
    columns = ["CSI_DATA", packet.number, mac, packet.rssi_dbm, 11, 0, 7, *[0] * 7, -95, 0, 6, 0]
    columns += [packet.time_us % (1 << 32), 0, 47, 0, len(numbers), 0]
    return [(",".join(map(str, columns)) + f',"[{",".join(map(str, numbers))}]"\r\n').encode()]


def side_channel(packet: Packet) -> list[bytes]:
    """A record of openwifi's."""
    return [openwifi.encode(packet.csi[0].astype(np.complex64), packet.time_us)]


def picoscenes(packet: Packet) -> list[bytes]:
    """A frame of PicoScenes with the CSI of a software radio."""
    antennas, count = packet.csi.shape
    basic = struct.pack("<HQQ", 0x2000, packet.time_us, packet.time_us * 1000)
    basic += struct.pack("<hhHBHHBBBB", 5180, 5180, 20, 1, 20, 800, 0, 1, 0, antennas)
    basic += b"\1\0" + struct.pack("<5b", -95, *[packet.rssi_dbm] * 4)
    data = (np.arange(count, dtype="<i2") - count // 2).tobytes()
    data += b"BBv2\4" + struct.pack("<4Q", count, 1, antennas, 1) + b"CF\x20C"
    data += packet.csi.T[:, None].transpose(2, 1, 0).astype("<c8").tobytes()
    csi = struct.pack("<HBbHQQB", 0x1234, 0x45, 1, 20, 5_180_000_000, 5_180_000_000, 0)
    csi += struct.pack("<QIHBBBH", 20_000_000, 312_500, count, 1, antennas, 0, 1)
    csi += b"\0" + struct.pack("<hI", 0, len(data)) + data
    sent = struct.pack("<HH", 0x88, 0) + DESTINATION + packet.address + bytes(12)
    body = struct.pack("<4sHBH", b"\x15\x03\x15\x20", 2, 2, 1)
    body += _segment(b"RxSBasic", 4, basic) + _segment(b"CSI", 6, csi) + struct.pack("<I", len(sent)) + sent
    return [struct.pack("<I", len(body)) + body]


FULL_SCALE = {"intel5300": 100.0, "esp32": 100.0}
"""Largest value of CSI that a tool's numbers hold; of all others 16 bits."""
ENCODERS: dict[str, Encode] = {
    "nexmon": nexmon,
    "nexmon_pcap": nexmon_pcap,
    "picoscenes": picoscenes,
    "feitcsi": feitcsi,
    "intel5300": intel5300,
    "esp32": esp32,
    "openwifi": side_channel,
}
SUBCARRIERS = {"intel5300": 30, "feitcsi": 56, "openwifi": 56}
"""How many a tool gives at 20 MHz; all others 64."""


def _pairs(values: NDArray[np.complex128], dtype: str) -> bytes:
    return np.rint(np.stack([values.real, values.imag], -1)).astype(dtype).tobytes()


def _record(code: int, body: bytes) -> bytes:
    return struct.pack(">HB", len(body) + 1, code) + body


def _segment(name: bytes, version: int, content: bytes) -> bytes:
    body = bytes([len(name)]) + name + struct.pack("<H", version) + content
    return struct.pack("<I", len(body)) + body
