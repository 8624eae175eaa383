"""Captures of Wi-Fi cards, written from the definitions of their formats."""

from __future__ import annotations

import base64
import struct

import numpy as np


def integers(*shape: int, limit: int = 100, seed: int = 1) -> np.ndarray:
    """Whole complex numbers."""
    rng = np.random.default_rng(seed)
    return rng.integers(-limit, limit, shape) + 1j * rng.integers(-limit, limit, shape)


def packed(values: np.ndarray, bits: int, gap: int = 0, every: int = 0) -> bytes:
    """Integers of so many bits one after another, lowest bit first, with `gap` bits before each `every`."""
    whole = at = 0
    for n, value in enumerate(values.tolist()):
        at += gap if every and n % every == 0 else 0
        whole |= (value & ((1 << bits) - 1)) << at
        at += bits
    return whole.to_bytes(-(-at // 8), "little")


def station(number: int) -> bytes:
    """The address 02:00:00:00:00:NN."""
    return bytes([2, 0, 0, 0, 0, number])


def packet_of(sender: bytes, length: int = 24) -> bytes:
    """An 802.11 header and zeros."""
    return (b"\x88\0\0\0" + b"\xff" * 6 + sender).ljust(length, b"\0")


def intel5300(
    csi: np.ndarray,
    order: str = "012",
    *,
    rate: int = 0x1101,
    clock: np.ndarray | None = None,
    senders: list[int] | None = None,
    fork: bool = False,
    payload: bytes = b"",
) -> bytes:
    """Frames (frames, 30, antennas, streams) of integers; `order` is the antenna of each receive chain."""
    _, _, antennas, sent = csi.shape
    chosen = sum(int(antenna) << 2 * chain for chain, antenna in enumerate(order))
    clock = 1_000_000 + 500 * np.arange(len(csi)) if clock is None else clock
    records = []
    for n, frame in enumerate(csi):
        pairs = np.stack([frame.real, frame.imag], -1).astype(int).ravel()
        data = packed(pairs, 8, 3, 2 * antennas * sent)
        head = (int(clock[n]) % (1 << 32), n, 0, antennas, sent, 40, 41, 42, -90, 30, chosen, len(data), rate)
        more = struct.pack("<II6sI", 1_600_000_000 + n, 5, station(9), n) if fork else b""
        body = struct.pack("<IHHBBBBBbBBHH", *head) + more + data
        if senders is not None and senders[n]:
            packet = packet_of(station(senders[n])) + payload
            records.append(struct.pack(">HB", len(packet) + 1, 0xC1) + packet)
        records.append(struct.pack(">HB", len(body) + 1, 0xBB) + body)
    return b"".join(records)


def atheros(csi: np.ndarray, order: str = "<", lengths: str | None = None, payload: bytes = b"xyz") -> bytes:
    """Frames (frames, subcarriers, antennas, streams) of integers; antennas are fastest in the file."""
    records = []
    for n, frame in enumerate(csi):
        pairs = np.stack([frame.imag, frame.real], -1).astype(int).transpose(0, 2, 1, 3)
        data = packed(pairs.ravel(), 10)
        data += bytes(-len(data) % 2)
        shape = (len(data), 2412, 0, -95, 1, 0, *frame.shape, 40, 41, 42, 43, len(payload))
        head = struct.pack(f"{order}QHHBbBBBBBBBBBH", 7000 + n, *shape)
        size = len(head) + len(data) + len(payload)
        records.append(struct.pack(f"{lengths or order}H", size) + head + data + payload)
    return b"".join(records)


CHANSPEC = {64: 0xD024, 128: 0xD826, 256: 0xE02A}
"""5 GHz: channel 36 at 20 MHz, 38 at 40, 42 at 80."""


def nexmon_payload(
    words: bytes, sender: bytes, seq: int, core: int, stream: int = 0, rssi: int = -50
) -> bytes:
    """A UDP payload: `words` in the order of the FFT."""
    told = struct.pack("<H", (rssi & 0xFF)) if rssi else b"\x11\x11"
    head = b"\x11\x11" + told + sender
    return head + struct.pack("<HHHH", seq, core | stream << 3, CHANSPEC[len(words) // 4], 0x65) + words


def udp(payload: bytes, trailer: bytes = b"") -> bytes:
    """An Ethernet frame with a UDP datagram to port 5500."""
    datagram = struct.pack(">HHHH", 5500, 5500, 8 + len(payload), 0) + payload
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(datagram), 0, 0, 1, 17, 0, bytes(4), b"\xff" * 4)
    return b"\xff" * 6 + b"NEXMON" + b"\x08\0" + ip + datagram + trailer


def pcap(packets: list[tuple[float, bytes]], link: int = 1) -> bytes:
    """A file of microseconds."""
    records = [struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)]
    for seconds, packet in packets:
        whole, part = divmod(round(seconds * 1e6), 1_000_000)
        records.append(struct.pack("<IIII", whole, part, len(packet), len(packet)) + packet)
    return b"".join(records)


def pcapng(packets: list[tuple[float, bytes]]) -> bytes:
    """A section of one interface that counts nanoseconds, and a block of a kind that nobody knows."""

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)

    blocks = [block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)), block(0xBAD, b"what")]
    blocks.append(block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0)))
    for seconds, packet in packets:
        ticks = round(seconds * 1e6) * 1000
        head = struct.pack("<IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(packet), len(packet))
        blocks.append(block(6, head + packet))
    return b"".join(blocks)


def nexmon_packets(
    csi: np.ndarray, missing: tuple[int, ...] = (), seq: list[int] | None = None
) -> list[tuple[float, bytes]]:
    """Frames (frames, cores, subcarriers) of integers, ascending, but for the packets numbered `missing`."""
    frames, cores, _ = csi.shape
    found = [(1.0, bytes(20))]
    for n in range(frames * cores):
        frame, core = divmod(n, cores)
        values = np.fft.ifftshift(csi[frame, core])
        words = np.stack([values.real, values.imag], -1).astype("<i2").tobytes()
        number = frame if seq is None else seq[frame]
        payload = nexmon_payload(words, station(1), number, core)
        if n not in missing:
            found.append((100 + 0.001 * frame, udp(payload, b"tail" if n % 3 == 0 else b"")))
    return found


def nexmon(csi: np.ndarray, missing: tuple[int, ...] = (), seq: list[int] | None = None) -> bytes:
    """The same as a pcap file."""
    return pcap(nexmon_packets(csi, missing, seq))


ESP32_HEADINGS = (
    "type,id,mac,rssi,rate,sig_mode,mcs,bandwidth,smoothing,not_sounding,aggregation,stbc,fec_coding,sgi,"
    "noise_floor,ampdu_cnt,channel,secondary_channel,local_timestamp,ant,sig_len,rx_state,len,first_word,data"
)


def esp32_line(
    frame: np.ndarray,
    n: int,
    *,
    secondary: int = 0,
    quoted: bool = True,
    packed64: bool = False,
    first_word: int = 0,
    clock: int | None = None,
    sender: int = 1,
) -> str:
    """A line of esp-csi with a frame's values in the order of the file."""
    values = np.stack([frame.imag, frame.real], -1).astype(int).ravel()
    address = ":".join(f"{octet:02X}" for octet in station(sender))
    clock = (2**32 - 10 + 20 * n) % 2**32 if clock is None else clock
    columns = [
        "CSI_DATA",
        str(n),
        address,
        "-40",
        "11",
        "0",
        "7",
        *["0"] * 7,
        "-95",
        "0",
        "6",
        str(secondary),
    ]
    columns += [str(clock), "0", "47", "0", str(len(values)), str(first_word)]
    text = "[" + ",".join(map(str, values)) + "]"
    if packed64:
        text = base64.b64encode(values.astype(np.int8).tobytes()).decode()
    return ",".join(columns) + "," + (f'"{text}"' if quoted else text)


def esp32(csi: np.ndarray) -> bytes:
    """Frames (frames, subcarriers) of integers in the order of the file, after headings and log messages."""
    lines = ["I (300) wifi: set country", ESP32_HEADINGS]
    lines += [esp32_line(frame, n) for n, frame in enumerate(csi)]
    return ("\r\n".join(lines) + "\r\n").encode()


def feitcsi(csi: np.ndarray, rate: int = 2 << 8) -> bytes:
    """Frames (frames, subcarriers, antennas, streams) of integers; `rate` as in rate_n_flags: HT, 20 MHz."""
    records = []
    for n, frame in enumerate(csi):
        tones, antennas, sent = frame.shape
        values = np.stack([frame.real, frame.imag], -1).transpose(1, 2, 0, 3).astype("<i2").tobytes()
        head = bytearray(272)
        struct.pack_into("<I", head, 0, len(values))
        struct.pack_into("<BB", head, 46, antennas, sent)
        struct.pack_into("<IxxxxII6s", head, 52, tones, 41, 39, station(3))
        struct.pack_into("<II", head, 88, 2**32 - 1000 + 1500 * n & 0xFFFFFFFF, rate)
        records.append(bytes(head) + values)
    return b"".join(records)
