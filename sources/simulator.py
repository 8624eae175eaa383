"""The simulator: a scenario's UEs, their channels and receiver noise, as a source of CSI."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.base import EndOfSource, Source, SourceSettings
from chachart.sources.scenario.channel import Channel, ChannelName, make_channel, mean_power, synthesise
from chachart.sources.scenario.layout import UE_HEIGHT_M, LayoutName, place
from chachart.sources.scenario.motion import Motion, MotionName, RandomWaypoint, Static
from chachart.sources.scenario.multipath import MAX_UES
from chachart.sources.scenario.phasor import phasor

log = logging.getLogger(__name__)

LINGER_S = 0.01
"""A frame that is due leaves after this long even if its block is not full."""
MAX_LAG_S = 0.5
"""A live simulator further behind its frame rate than this gives up what it is late with."""

_FAST_UE_RATE_HZ = 10.0
_CACHE_BYTES = 512 << 20
_BLOCK_BYTES = 256 << 20
_NOISE_STREAM = 3
_PHASE_STREAM = 4


class SimulatorSettings(SourceSettings):
    """Simulated UEs before the array, line-of-sight or multipath channels, receiver noise."""

    type: Literal["simulator"] = "simulator"
    """Which source."""
    layout: LayoutName = "vip"
    """Where the UEs are: `vip` (uniform, the first 234 draw the letters), `uniform` or `grid`."""
    ues: int = Field(2048, ge=1, le=200_000)
    """How many UEs."""
    ue_height_m: float = UE_HEIGHT_M
    """Height of the UEs above the ground (world z)."""
    ue_highest_m: float | None = None
    """UEs are at random heights from ue_height_m up to this; not set: all at ue_height_m."""
    area_m: tuple[float, float, float, float] = (100.0, 600.0, -500.0, 500.0)
    """Where: nearest and farthest ahead of the array, then from and to along its axis."""
    area_in: Literal["array", "world"] = "array"
    """`world`: area_m is from and to along the world's x, then y, as simulators of several arrays need it."""
    channel: ChannelName = "los"
    """`los`, a spherical wave; `qlos` and `qnlos`, urban macro cells with and without line of sight."""
    exponent: float = Field(1.0, ge=0, le=8)
    """Of the amplitude over distance in the `los` channel: 1 in free space."""
    random_phase: bool = False
    """Turn every frame by a random phase, as free-running oscillators do."""
    snr_db: float = Field(0.0, ge=-60, le=200)
    """Mean of |h|^2 over all UEs, antennas and subcarriers against the noise in each."""
    motion: MotionName = "static"
    """`static`, or `waypoint`: from point to random point in straight lines."""
    speed_m_s: float = Field(1.5, gt=0, le=1000)
    """How fast UEs walk, with motion = "waypoint"."""
    frame_rate_hz: float = Field(5000.0, ge=0, le=10e6)
    """Frames a second, all UEs together, in turn. 0: as fast as the node takes them, none lost; frame
    times then are as if every UE sent ten frames a second."""
    in_step: bool = False
    """Frame n is due n / frame_rate_hz seconds after 1970, and says so: simulators of several arrays with
    the same seed, area in the world, UEs and rate then hear the same transmissions."""
    frames: int | None = Field(None, ge=1)
    """End after so many frames; not set: never."""
    known_ues: int | None = Field(None, ge=0)
    """Frames carry the true position of the first so many UEs; not set: of all."""
    seed: int = Field(0, ge=0)
    """Same seed, same positions, channels and noise."""
    block_frames: int = Field(64, ge=1, le=4096)
    """At most so many frames are made at once."""


class Simulator(Source):
    """A source that makes its frames up. UEs take turns: frame n is of UE n modulo `ues`.

    Live at a frame rate, by a clock: when it cannot keep up (a slow machine, a large array) it skips time
    rather than falling ever further behind, and says so. Lossless when `frame_rate_hz` is 0.

    The channels of UEs that stand still are computed once, in `recv` so that nobody waits for them unknowing,
    and only noise is added to each frame; those of moving UEs are computed frame by frame. `clock` and
    `sleep` are what time it takes its pace from.
    """

    Settings: ClassVar[type[SourceSettings]] = SimulatorSettings
    settings: SimulatorSettings

    def __init__(
        self,
        settings: SimulatorSettings,
        array: ArrayGeometry,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(settings, array)
        self.lossless = settings.frame_rate_hz == 0
        self._clock, self._sleep = clock, sleep
        self._rate = settings.frame_rate_hz or _FAST_UE_RATE_HZ * settings.ues
        self._prepared = 0
        self._to_prepare = 0
        self._work: Iterator[None] | None = None
        self._still: NDArray[np.complex64] | None = None
        self._begin()

    @classmethod
    def problems(cls, settings: SimulatorSettings) -> list[str]:
        """More UEs than multipath channels can be kept of, or an area or heights that are none."""
        x0, x1, y0, y1 = settings.area_m
        if x0 >= x1 or y0 >= y1:
            return [f"area_m = {list(settings.area_m)}: must be nearest < farthest, then from < to"]
        if settings.ue_highest_m is not None and settings.ue_highest_m < settings.ue_height_m:
            return [f"ue_highest_m = {settings.ue_highest_m:g}: must be at least ue_height_m"]
        if settings.in_step and settings.frame_rate_hz == 0:
            return ["in_step = true: must have a frame_rate_hz"]
        if settings.channel != "los" and settings.ues > MAX_UES:
            return [f"ues = {settings.ues}: {settings.channel} channels take at most {MAX_UES}"]
        return []

    def _begin(self) -> None:
        """Back to frame 0."""
        self._sent = self._first = 0
        self._skipped_s = 0.0
        self._started = False
        self._start = 0.0
        self._start_ns = 0

    def open(self) -> None:
        """Place the UEs and get ready to compute their channels.

        Raises
        ------
        SetupError
            If a block of such frames would be unreasonably large.
        """
        s, frame_bytes = self.settings, 8 * self.array.antennas * self.array.subcarriers
        if s.block_frames * frame_bytes > _BLOCK_BYTES:
            raise SetupError(
                f"[source] block_frames = {s.block_frames}: blocks of {self.array.antennas} antennas x "
                f"{self.array.subcarriers} subcarriers take {s.block_frames * frame_bytes >> 20} MiB each; "
                f"at most {max(1, _BLOCK_BYTES // frame_bytes)} frames fit {_BLOCK_BYTES >> 20} MiB"
            )
        self._begin()
        area = (s.area_m[:2], s.area_m[2:])
        before = self.array if s.area_in == "array" else _world_frame(self.array)
        start = place(s.layout, s.ues, before, s.seed, s.ue_height_m, area, s.ue_highest_m)
        self._motion: Motion = Static(start)
        if s.motion == "waypoint":
            self._motion = RandomWaypoint(start, before, s.speed_m_s, s.seed, area=area)
        self._channel: Channel = make_channel(s.channel, self.array, start, s.seed, s.exponent)
        self._known = s.ues if s.known_ues is None else s.known_ues
        self._noise = np.random.Generator(np.random.SFC64([s.seed, _NOISE_STREAM]))
        self._phases = np.random.default_rng([s.seed, _PHASE_STREAM])
        self._noise_std = np.float32(np.sqrt(0.5 * 10 ** (-s.snr_db / 10)))
        fits = max(1, _CACHE_BYTES // frame_bytes)
        self._to_prepare = min(s.ues, fits)
        self._work = self._prepare(start, keep=s.motion == "static" and s.ues <= fits)

    def recv(self, timeout: float) -> CsiBlock | None:
        """The next block, or None if no frame was due within `timeout` seconds.

        Raises
        ------
        EndOfSource
            After `frames` frames.
        """
        deadline = self._clock() + timeout
        if self._work is not None and not self._work_until(deadline):
            return None
        if not self._started:
            self._started = True
            self._start, self._start_ns = self._clock(), time.time_ns()
            if self.settings.in_step:
                self._catch_up()
        wanted = self.settings.block_frames
        if self.settings.frames is not None:
            wanted = min(wanted, self.settings.frames - self._sent)
            if wanted <= 0:
                raise EndOfSource
        due = wanted if self.lossless else self._wait(wanted, deadline)
        return self._block(due) if due else None

    def position(self) -> dict[str, Any] | None:
        """How many frames it has made since when; None where it keeps a frame rate, as the world would."""
        return {"frames": self._sent, "start_ns": self._start_ns} if self.lossless else None

    def resume(self, position: dict[str, Any]) -> None:
        """Make the same frames again, to go on behind them with the same noise."""
        if self._work is not None:
            self._work_until(math.inf)
        self._started = True
        self._start, self._start_ns = self._clock(), position["start_ns"] or time.time_ns()
        while (left := position["frames"] - self._sent) > 0:
            self._block(min(left, self.settings.block_frames))

    def close(self) -> None:
        """Forget the channels."""
        self._work = self._still = None

    def details(self) -> dict[str, Any]:
        """`channels_ready` (0..1), and `skipped_s`, the time given up because frames came too slowly."""
        ready = self._prepared / self._to_prepare if self._to_prepare else 0.0
        return {"channels_ready": round(ready, 3), "skipped_s": round(self._skipped_s, 3)}

    def _prepare(self, start: NDArray[np.float64], keep: bool) -> Iterator[None]:
        """Compute channels at the start, for their mean power and, with `keep`, for good."""
        some = np.linspace(0, len(start) - 1, self._to_prepare).astype(np.int64)
        out = np.empty((len(some), self.array.antennas, self.array.subcarriers), np.complex64)
        said = self._clock()
        for done in synthesise(self._channel, some, start[some], out):
            self._prepared = done
            if self._clock() - said >= 1.0:
                said = self._clock()
                log.info("computing %s channels: %d of %d UEs", self.settings.channel, done, len(some))
            yield
        self._scale = np.float32(mean_power(out) ** -0.5)
        if keep:
            out *= self._scale
            self._still = out

    def _work_until(self, deadline: float) -> bool:
        """Go on preparing; whether that is finished before the deadline."""
        assert self._work is not None
        for _ in self._work:
            if self._clock() >= deadline:
                return False
        self._work = None
        return True

    def _wait(self, wanted: int, deadline: float) -> int:
        """Sleep until `wanted` frames are due, the first has lingered, or the deadline; how many are due.

        Frame n is due n / rate after the start; being too late moves the start.
        """
        first = self._start + self._sent / self._rate
        ready = first + min((wanted - 1) / self._rate, LINGER_S)
        now = self._clock()
        if now < ready:
            self._sleep(max(0.0, min(ready, deadline) - now))
            now = self._clock()
            if now < ready:
                return 0
        late = now - first - wanted / self._rate
        if late > MAX_LAG_S:
            self._skip(late)
            return 0 if self.settings.in_step else wanted
        return min(wanted, int((now - first) * self._rate) + 1)

    def _skip(self, seconds: float) -> None:
        """Take up the frame rate again from now on."""
        if self._skipped_s == 0:
            log.warning("the simulator cannot make %g frames/s here: skipping time", self._rate)
        self._skipped_s += seconds
        if self.settings.in_step:
            self._catch_up()
            return
        self._start += seconds
        self._start_ns += int(seconds * 1e9)

    def _catch_up(self) -> None:
        """The next frame is the first that is due from now on, counted since 1970."""
        now_ns, began = time.time_ns(), self._clock()
        next_frame = math.ceil(now_ns * 1e-9 * self._rate)
        self._first = next_frame - self._sent
        self._start_ns = 0
        self._start = began - now_ns * 1e-9 + self._first / self._rate

    def _block(self, k: int) -> CsiBlock:
        """The next k frames."""
        frame = self._first + self._sent + np.arange(k)
        ue = frame % self.settings.ues
        time_s = frame / self._rate
        position = self._motion.at(ue, time_s)
        noise = self._noise.standard_normal(
            (k, self.array.antennas, 2 * self.array.subcarriers), dtype=np.float32
        )
        noise *= self._noise_std
        csi = noise.view(np.complex64)
        if self._still is not None:
            clean = self._still[ue]
        else:
            clean = self._channel.csi(ue, position)
            clean *= self._scale
        if self.settings.random_phase:
            clean *= phasor(self._phases.random(k))[:, None, None]
        csi += clean
        shown = position.astype(np.float32)
        shown[ue >= self._known] = np.nan
        seq, self._sent = self._sent, self._sent + k
        return CsiBlock(
            array=self.array.name,
            seq=seq,
            ue=ue.astype(np.uint64),
            time_ns=self._start_ns + (time_s * 1e9).astype(np.int64),
            csi=csi,
            position=shown if self._known else None,
            packet=(frame + 1).astype(np.uint64) if self.settings.in_step else None,
        )


def _world_frame(array: ArrayGeometry) -> ArrayGeometry:
    """The array where an area ahead of it and along its axis is one along the world's x and y."""
    return replace(array, position_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0), broadside=(1.0, 0.0, 0.0))
