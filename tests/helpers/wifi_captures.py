"""Captures of Wi-Fi cards, written from the definitions of their formats."""

from __future__ import annotations

import struct

import numpy as np


def packed(values: np.ndarray, bits: int, gap: int = 0, every: int = 0) -> bytes:
    """Integers of so many bits one after another, lowest bit first, with `gap` bits before each `every`."""
    whole = at = 0
    for n, value in enumerate(values.tolist()):
        at += gap if every and n % every == 0 else 0
        whole |= (value & ((1 << bits) - 1)) << at
        at += bits
    return whole.to_bytes(-(-at // 8), "little")


def intel5300(csi: np.ndarray, order: str = "012") -> bytes:
    """Frames (frames, 30, antennas, streams) of integers; `order` is the antenna of each receive chain."""
    _, _, antennas, sent = csi.shape
    chosen = sum(int(antenna) << 2 * chain for chain, antenna in enumerate(order))
    records = []
    for n, frame in enumerate(csi):
        pairs = np.stack([frame.real, frame.imag], -1).astype(int).ravel()
        data = packed(pairs, 8, 3, 2 * antennas * sent)
        head = (1_000_000 + 500 * n, n, 0, antennas, sent, 40, 41, 42, -90, 30, chosen, len(data), 0x1101)
        body = struct.pack("<IHHBBBBBbBBHH", *head) + data
        records.append(struct.pack(">HB", len(body) + 1, 0xBB) + body)
    records.insert(1, struct.pack(">HB", 5, 0xC1) + b"mpdu")
    return b"".join(records)


def atheros(csi: np.ndarray, order: str = "<") -> bytes:
    """Frames (frames, subcarriers, antennas, streams) of integers."""
    records = []
    for n, frame in enumerate(csi):
        data = packed(np.stack([frame.imag, frame.real], -1).astype(int).ravel(), 10)
        data += bytes(-len(data) % 2)
        shape = (len(data), 2412, 0, 0, 1, 0, *frame.shape, 1, 2, 3, 4, 3)
        head = struct.pack(f"{order}QHHBBBBBBBBBBBH", 7000 + n, *shape)
        records.append(struct.pack(f"{order}H", len(head) + len(data) + 3) + head + data + b"xyz")
    return b"".join(records)


def nexmon(csi: np.ndarray, missing: tuple[int, ...] = ()) -> bytes:
    """Frames (frames, cores, subcarriers) of 16-bit integers, but for the packets numbered `missing`."""
    packets = [struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
    frames, cores, _ = csi.shape
    for n in range(frames * cores):
        if n in missing:
            continue
        seq, core = divmod(n, cores)
        values = np.stack([csi[seq, core].real, csi[seq, core].imag], -1).astype("<i2").tobytes()
        head = struct.pack("<I6sHHHH", 0x11111111, bytes([0, 0, 0, 0, 1, seq]), seq, core, 0xE09B, 0x4345)
        packet = b"\xff" * 6 + b"NEXMON" + bytes(30) + head + values
        packets.append(struct.pack("<IIII", 100 + seq, 500, len(packet), len(packet)) + packet)
    packets.append(struct.pack("<IIII", 1, 1, 20, 20) + bytes(20))
    return b"".join(packets)


def esp32(csi: np.ndarray) -> bytes:
    """Frames (frames, subcarriers) of integers, after a line of headings."""
    lines = ["type,role,mac"]
    for n, frame in enumerate(csi):
        values = np.stack([frame.imag, frame.real], -1).astype(int).ravel()
        columns = ["CSI_DATA", "AP", "AA:BB", *["1"] * 15, str(2**32 - 10 + 20 * n), *["1"] * 5]
        lines.append(",".join([*columns, str(len(values)), f"[{' '.join(map(str, values))} ]"]))
    return "\n".join(lines).encode()
