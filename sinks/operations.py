"""What people may ask a running node over ZeroMQ, HTTP or the live view: the same operations everywhere.

    status                          the latest status report, with the quality report
    ues                             who is in the chart
    chart                           the whole chart, as columns
    spectrum   ue                   theta and rho spectra of one UE
    antennas   ue                   level and phase of its newest frame by antenna and by subcarrier
    recordings                      what is in the recording folder
    set_method theta, rho           estimate with these methods from now on
    replay     paused, speed, at_s  pause, pace and wind a recording that is played; all of them optional
    start_recording  path           record the CSI that comes in to a file of that name;
                                    with `compression`, "none" or "zstd"
    stop_recording                  close that recording

`method` for `set_method`, and `record` with `on` and `path`, are older names of the same. A request that does
not fit gets a `RequestError` in one line and changes nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from chachart.node.data.errors import RequestError
from chachart.node.data.methods import RhoMethod, ThetaMethod
from chachart.node.data.settings import Settings
from chachart.node.net.security import Role
from chachart.sinks.base import NodeAccess
from chachart.sinks.recordings import Recordings

_FILE_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*\.mcap$"


class _Status(Settings):
    op: Literal["status"]


class _Ues(Settings):
    op: Literal["ues"]


class _Chart(Settings):
    op: Literal["chart"]


class _Spectrum(Settings):
    op: Literal["spectrum"]
    ue: int = Field(ge=0, lt=2**64)


class _SetMethod(Settings):
    op: Literal["set_method", "method"]
    theta: ThetaMethod
    rho: RhoMethod


class _Antennas(Settings):
    op: Literal["antennas"]
    ue: int = Field(ge=0, lt=2**64)


class _Recordings(Settings):
    op: Literal["recordings"]


class _Replay(Settings):
    op: Literal["replay"]
    paused: bool | None = None
    speed: float | None = Field(None, ge=0, le=1000)
    at_s: float | None = Field(None, ge=0)


class _StartRecording(Settings):
    op: Literal["start_recording"]
    path: str = Field(max_length=128, pattern=_FILE_NAME)
    compression: Literal["none", "zstd"] = "none"


class _StopRecording(Settings):
    op: Literal["stop_recording"]


class _Record(Settings):
    op: Literal["record"]
    on: bool
    path: str | None = Field(None, max_length=128, pattern=_FILE_NAME)
    compression: Literal["none", "zstd"] = "none"

    @model_validator(mode="after")
    def _named(self) -> _Record:
        if self.on and self.path is None:
            raise ValueError("path must name the file to record to")
        return self


_Request = (
    _Status
    | _Ues
    | _Chart
    | _Spectrum
    | _Antennas
    | _Recordings
    | _SetMethod
    | _Replay
    | _StartRecording
    | _StopRecording
    | _Record
)
_REQUESTS: TypeAdapter[_Request] = TypeAdapter(Annotated[_Request, Field(discriminator="op")])

READING = ("status", "ues", "chart", "spectrum", "antennas", "recordings")
"""Operations that change nothing."""
WHOLE = ({"op": "ues"}, {"op": "chart"})
"""Requests whose answer is as long as the chart."""
WHOLE_EVERY_S = 1.0
CHANGING = ("set_method", "replay", "start_recording", "stop_recording", "method", "record")
"""Operations that change what the node does, under their newer and older names."""


class Operations:
    """Carries out requests.

    Parameters
    ----------
    node
        Whom to ask.
    folder
        Where recordings go; a request names a file in it and nothing else.
    """

    def __init__(self, node: NodeAccess, folder: Path) -> None:
        self._node = node
        self._kept: dict[tuple[Any, Any], tuple[float, bytes]] = {}
        self._lock = threading.Lock()
        self._folder = folder
        self.recordings = Recordings(folder)

    def reply(
        self, request: Mapping[str, Any], role: Role, encode: Callable[[Mapping[str, Any]], bytes]
    ) -> bytes:
        """As `perform`, encoded; what is about the whole chart is put together once a second at most.

        Raises
        ------
        RequestError
            As `perform`.
        """
        if request not in WHOLE:
            return encode(self.perform(request, role))
        key = (request["op"], encode)
        with self._lock:
            until, body = self._kept.get(key, (0.0, b""))
            if time.monotonic() >= until:
                body = encode(self.perform(request, role))
                self._kept[key] = time.monotonic() + WHOLE_EVERY_S, body
            return body

    def perform(self, request: Mapping[str, Any], role: Role = Role.STEERER) -> Mapping[str, Any]:
        """Carry out `{"op": ..., arguments ...}`; the answer may hold arrays. May block for seconds.

        Raises
        ------
        RequestError
            If the request does not fit, is beyond `role`, or the node cannot carry it out; nothing has
            changed then.
        """
        if role < Role.STEERER and not _only_reads(request):
            raise RequestError(f"who may only read asks {', '.join(READING)}")
        try:
            asked = _REQUESTS.validate_python(dict(request))
        except ValidationError as error:
            raise RequestError(_first_mistake(error)) from None
        return self._answer(asked)

    def _answer(self, asked: _Request) -> Mapping[str, Any]:
        match asked:
            case _Status():
                return {**self._node.status(), "quality": self._node.quality()}
            case _Ues():
                return self._node.ues()
            case _Chart():
                return self._node.chart_columns()
            case _Spectrum():
                return self._node.spectrum(asked.ue)
            case _Antennas():
                return self._node.antennas(asked.ue)
            case _Recordings():
                return self.recordings.list()
            case _SetMethod():
                return self._node.set_method(asked.theta, asked.rho)
            case _Replay():
                return self._node.replay(paused=asked.paused, speed=asked.speed, at_s=asked.at_s)
            case _StartRecording(path=str(path)) | _Record(on=True, path=str(path)):
                return self._record(path, asked.compression)
            case _:
                return self._node.stop_recording()

    def _record(self, path: str, compression: str) -> dict[str, Any]:
        target = self._folder / path
        if target.exists():
            raise RequestError(f"{path} is there already; recordings are never overwritten")
        if not self._folder.is_dir():
            raise RequestError(f"the recording folder {self._folder} does not exist")
        return self._node.start_recording(target, compression)


def _only_reads(request: Mapping[str, Any]) -> bool:
    """Whether it changes nothing; a replay without a wish only tells how it stands."""
    return request.get("op") in READING or dict(request) == {"op": "replay"}


def _first_mistake(error: ValidationError) -> str:
    mistake = error.errors(include_url=False, include_context=False)[0]
    if mistake["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return f"op must be one of {', '.join(READING + CHANGING)}"
    where = ".".join(str(part) for part in mistake["loc"][1:])
    if mistake["type"] == "string_pattern_mismatch":
        return f"{where}: must be a file name that ends in .mcap, of letters, digits, . - and _"
    if mistake["type"] == "literal_error":
        known = [str(name) for name in get_args(ThetaMethod if where.endswith("theta") else RhoMethod)]
        close = get_close_matches(str(mistake["input"]), known, n=1)
        hint = f'; did you mean "{close[0]}"?' if close else ""
        return f"{where.split('.')[-1]} must be one of {', '.join(known)}{hint}"
    text = mistake["msg"].removeprefix("Value error, ")
    return f"{where}: {text}" if where else text
