"""The C reference encoder against the Python codec, byte for byte."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

from chachart.sources.frontend import packet as packet_module
from chachart.sources.frontend.framing import encode_frame
from chachart.sources.frontend.packet import CsiPacket, Hello, Packet, SampleFormat, decode, encode

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
SOURCE = Path(packet_module.__file__).with_name("c")


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    if COMPILER is None:
        pytest.skip("no C compiler here")
    target = tmp_path_factory.mktemp("c") / "encoder.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *flags, "-o", target, SOURCE / "encoder.c"], check=True)
    loaded = ctypes.CDLL(str(target))
    u8, u16, u32, u64 = ctypes.c_char_p, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64
    loaded.chachart_csi.argtypes = [u8, u32, u64, u64, u16, u16, ctypes.c_int, ctypes.c_float, u8]
    double = ctypes.c_double
    hello = [u8, u32, u64, u16, u16, ctypes.c_float, double, double, u8]
    loaded.chachart_hello.argtypes = hello
    loaded.chachart_hello_elements.argtypes = [*hello, ctypes.POINTER(ctypes.c_float)]
    loaded.chachart_heartbeat.argtypes = [u8, u32, u64]
    loaded.chachart_frame.argtypes = [u8, u8, ctypes.c_size_t]
    for name in ("csi", "hello", "hello_elements", "heartbeat", "frame"):
        getattr(loaded, f"chachart_{name}").restype = ctypes.c_size_t
    return loaded


def encode_in_c(library: ctypes.CDLL, packet: Packet) -> bytes:
    out = ctypes.create_string_buffer(4096)
    head = (out, packet.seq, packet.time_ns)
    if isinstance(packet, CsiPacket):
        antennas, subcarriers, _ = packet.samples.shape
        fmt = {1: SampleFormat.INT8, 2: SampleFormat.INT16, 4: SampleFormat.FLOAT32}[packet.samples.itemsize]
        raw = packet.samples.tobytes()
        n = library.chachart_csi(*head, packet.ue, antennas, subcarriers, fmt, packet.scale, raw)
    elif isinstance(packet, Hello):
        numbers = (packet.element_spacing_m, packet.carrier_hz, packet.subcarrier_spacing_hz)
        shape = (packet.antennas, packet.subcarriers)
        told = (*head, *shape, *numbers, packet.serial.encode())
        if packet.elements is None:
            n = library.chachart_hello(*told)
        else:
            flat = [value for place in packet.elements for value in place]
            n = library.chachart_hello_elements(*told, (ctypes.c_float * len(flat))(*flat))
    else:
        n = library.chachart_heartbeat(*head)
    return out.raw[:n]


@given(data=st.data())
def test_both_encoders_write_the_same_bytes(packets, library, data):
    packet = data.draw(packets)
    in_c = encode_in_c(library, packet)
    assert in_c == encode(packet)
    assert encode(decode(in_c)) == in_c


def frame_in_c(library: ctypes.CDLL, packet: bytes) -> bytes:
    out = ctypes.create_string_buffer(len(packet) + len(packet) // 254 + 3)
    n = library.chachart_frame(out, packet, len(packet))
    return out.raw[:n]


@given(raw=st.one_of(st.binary(max_size=40), st.binary(min_size=250, max_size=800)), fill=st.booleans())
def test_both_frame_a_packet_alike(library, raw, fill):
    packet = raw.replace(b"\0", b"x") if fill else raw
    assert frame_in_c(library, packet) == encode_frame(packet)


@pytest.mark.parametrize("length", [0, 1, 253, 254, 255, 507, 508, 509])
def test_framing_at_the_ends_of_a_cobs_block(library, length):
    for packet in (b"x" * length, b"x" * length + b"\0", b"\0" * length):
        assert frame_in_c(library, packet) == encode_frame(packet)


def test_the_reference_fits_on_a_page_or_two():
    assert len((SOURCE / "encoder.c").read_text().splitlines()) <= 90
