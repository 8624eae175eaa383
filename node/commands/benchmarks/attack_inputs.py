"""The decoders that take what strangers send, each with samples to mutate and what it may raise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import zmq
from isal.isal_zlib import crc32

from chachart.node.data.chart import ChartUpdate, Method
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import RequestError
from chachart.node.data.extras import require
from chachart.node.net.wire import (
    WireError,
    decode_chart,
    decode_csi,
    decode_csi_map,
    decode_report,
    encode_chart,
    encode_csi,
    encode_csi_map,
    encode_report,
)
from chachart.sinks.control import decode_request
from chachart.sources.frontend import packet
from chachart.sources.live.device import CodecError
from chachart.sources.live.espargos import message, stream, uart
from chachart.sources.live.krakensdr import heimdall
from chachart.sources.live.oai import tracer
from chachart.sources.live.oai.gnb import DESCRIPTIONS

_SEPARATOR = b"<part>"


@dataclass(frozen=True, slots=True)
class Decoder:
    """`decode` gives a value for an input or raises one of `refusals`."""

    samples: list[bytes]
    decode: Callable[[bytes], Any]
    refusals: tuple[type[Exception], ...]


def block(frames: int = 3) -> CsiBlock:
    """Some frames of an array of 2 x 3."""
    rng = np.random.default_rng(frames)
    csi = rng.normal(size=(frames, 2, 6)).view(np.complex128).astype(np.complex64)
    ue = np.arange(frames, dtype=np.uint64)
    return CsiBlock(
        "lab", 7, ue, np.full(frames, 10**18), csi, rng.normal(size=(frames, 3)).astype(np.float32)
    )


def _chart() -> ChartUpdate:
    columns = {name: np.linspace(0, 1, 5) for name in ("theta", "rho", "x", "y", "snr", "snapshots")}
    return ChartUpdate(
        "lab", Method("music", "music"), ue=np.arange(5, dtype=np.uint64), time_ns=np.arange(5), **columns
    )


def _csi() -> Decoder:
    samples = [_SEPARATOR.join(map(bytes, encode_csi(block(n)))) for n in (1, 3)]
    return Decoder(samples, lambda data: decode_csi(data.split(_SEPARATOR)), (WireError,))


def _csi_map() -> Decoder:
    samples = [b"".join(map(bytes, encode_csi_map(block(n)))) for n in (1, 3)]
    return Decoder(samples, decode_csi_map, (WireError,))


def _charts() -> Decoder:
    return Decoder([encode_chart(_chart(), 9)], decode_chart, (WireError,))


def _reports() -> Decoder:
    body = encode_report(
        "status", "lab", 3, 10**18, {"frames_in": 7, "dropped": {"late": 3}, "workers": [{}]}
    )
    return Decoder([body], lambda data: decode_report("status", data), (WireError,))


def _control() -> Decoder:
    asked: list[dict[str, Any]] = [
        {"op": "spectrum", "ue": 7, "token": "a token of some length"},
        {"op": "set_method", "theta": "music", "rho": "music"},
        {"op": "start_recording", "path": "a.mcap"},
    ]
    samples = [json.dumps(one).encode() for one in asked] + [msgpack.packb(one) for one in asked]
    return Decoder(samples, lambda data: decode_request([zmq.Frame(data)]), (RequestError,))


def _packets() -> list[bytes]:
    csi = packet.CsiPacket.quantise(4, 10**9, 7, block(1).csi[0], packet.SampleFormat.INT8)
    hello = packet.Hello(5, 10**9, 2, 3, 2e9, 312500.0, 0.07, "ESP-1", ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)))
    return [packet.encode(one) for one in (csi, hello, packet.Heartbeat(6, 10**9))]


def _packet() -> Decoder:
    return Decoder(_packets(), packet.decode, (packet.PacketError,))


def _sealed_packet() -> Decoder:
    """Behind the checksum, which mutations do not get past."""

    def decode(data: bytes) -> Any:
        return packet.decode(data[:-4] + crc32(data[:-4]).to_bytes(4, "little"))

    return Decoder(_packets(), decode, (packet.PacketError,))


def _stream() -> Decoder:
    require("serial", "chachart bench attack:")
    from chachart.sources.frontend.framing import StreamDecoder, encode_frame

    rejected = Counters()
    decoder = StreamDecoder(4096, rejected)
    sample = b"".join(map(encode_frame, _packets() * 3))
    return Decoder([sample], decoder.feed, ())


def _espargos() -> Decoder:
    csi = np.ones(len(message.TONES), np.complex64)
    heard = message.SensorCsi(0x1122, 2**48 - 1, 0x1230, False, False, 10**10, csi, -61, -96, 6, -1)
    return Decoder([message.encode_message(heard)], message.decode_message, (CodecError,))


def _sealed_espargos() -> Decoder:
    plain = _espargos()
    seal = plain.samples[0][-7:-4]

    def decode(data: bytes) -> Any:
        return plain.decode(data[:-7] + seal + crc32(data[:-7]).to_bytes(4, "little"))

    return Decoder(plain.samples, decode, plain.refusals)


def _espargos_packet() -> Decoder:
    [sample] = _espargos().samples
    fragments = [stream.Fragment(7, n, 2, part) for n, part in enumerate((sample[:100], sample[100:]))]
    packet = stream.encode_packet(fragments)
    return Decoder([packet], lambda data: list(stream.decode_packet(data)), (CodecError,))


def _uart() -> Decoder:
    bodies = {
        uart.Kind.REQUEST: uart.request("GET", "/csi", b"{}"),
        uart.Kind.RESPONSE: uart.response(200, b"fine"),
        uart.Kind.HELLO_RESPONSE: uart.hello_response("board", "2", 1, 0),
    }

    def decode(data: bytes) -> Any:
        frame = uart.decode(data)
        match frame.kind:
            case uart.Kind.REQUEST:
                return uart.parse_request(frame.payload)
            case uart.Kind.RESPONSE:
                return uart.parse_response(frame.payload)
        return uart.parse_hello(frame.payload)

    samples = [uart.encode(uart.UartFrame(kind, 3, body)) for kind, body in bodies.items()]
    return Decoder(samples, decode, (CodecError,))


def _heimdall() -> Decoder:
    header = heimdall.Header(heimdall.DATA, 5, 64, 32, 433_000_000, 2_400_000, 10**18, 7, 3, True, False)
    sample = heimdall.encode_frame(header, np.zeros((5, 64), np.complex64))[: heimdall.HEADER_BYTES]

    def decode(data: bytes) -> int:
        whole = data.ljust(heimdall.HEADER_BYTES, b"\0")[: heimdall.HEADER_BYTES]
        return heimdall.decode_header(whole).payload_bytes

    return Decoder([sample], decode, (CodecError,))


def _tracer() -> Decoder:
    events = [tracer.Event(10**18, n, bytes(40)) for n in range(4)]
    sample = b"".join(map(tracer.encode_event, events))
    return Decoder([sample], lambda data: list(tracer.EventStream().feed(data)), (CodecError,))


def _descriptions() -> Decoder:
    return Decoder(
        [DESCRIPTIONS.encode()],
        lambda data: tracer.parse_descriptions(data.decode("latin-1")),
        (CodecError,),
    )


DECODERS: dict[str, Callable[[], Decoder]] = {
    "csi": _csi,
    "csi-map": _csi_map,
    "chart": _charts,
    "report": _reports,
    "control": _control,
    "packet": _packet,
    "packet-sealed": _sealed_packet,
    "stream": _stream,
    "espargos": _espargos,
    "espargos-sealed": _sealed_espargos,
    "espargos-packet": _espargos_packet,
    "espargos-uart": _uart,
    "heimdall": _heimdall,
    "tracer": _tracer,
    "tracer-descriptions": _descriptions,
}
