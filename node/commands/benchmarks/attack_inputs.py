"""The decoders that take what strangers send, each with samples to mutate and what it may raise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import zmq

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


def _stream() -> Decoder:
    require("serial", "chachart bench attack:")
    from chachart.sources.frontend.framing import StreamDecoder, encode_frame

    rejected = Counters()
    decoder = StreamDecoder(4096, rejected)
    sample = b"".join(map(encode_frame, _packets() * 3))
    return Decoder([sample], decoder.feed, ())


DECODERS: dict[str, Callable[[], Decoder]] = {
    "csi": _csi,
    "csi-map": _csi_map,
    "chart": _charts,
    "report": _reports,
    "control": _control,
    "packet": _packet,
    "stream": _stream,
}
