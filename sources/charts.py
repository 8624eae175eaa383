"""Charts of another node as a source, so that what several nodes say of a UE is fused into one position.

A row says in which direction, and how far, the other node's array hears a UE, and how sure it is. What fusion
knows is frames; so a row becomes the frame of which just that could be said: a wave from there, in noise so
strong that its likelihood is as wide as the row's deviations. Where it carries the strongest paths of a frame
(`[estimator] path_list` of the other node), these and noise for the rest are the frame. Everything behind it
(fuser, tracker, weights) is then the same, whether frames or rows come.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.csi import CsiBlock
from chachart.node.data.errors import SetupError
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.methods import FUSION
from chachart.node.data.path_list import FAR_M, NEAREST_M, PathList
from chachart.node.net.client import Subscription, subscribe
from chachart.node.net.keys import load_public
from chachart.sources.base import Source, SourceSettings

LEAST_NOISE, MOST_NOISE = 1e-3, 1.0
"""Power of the noise against that of the wave."""
UNKNOWN_NOISE = 0.1
"""Where a row does not say how sure it is."""


class ChartsSettings(SourceSettings):
    """`type = "charts"`: what another node says of UEs, for a node that fuses several of them."""

    type: Literal["charts"] = "charts"
    """Which source."""
    endpoint: str = Field("tcp://127.0.0.1:5556", min_length=1)
    """Where that node publishes its chart."""
    chart: str | None = Field(None, min_length=1, max_length=64, examples=["north"])
    """Which of its charts; not set: the one of the array's name."""
    ranges: bool = True
    """Whether its distances mean something: false where they are amplitudes or relative delays."""
    key: Path | None = None
    """Your `NAME.key_secret`, for a node with keys."""
    server_key: Path | None = None
    """That node's `node.key`."""
    queue_messages: int = Field(256, ge=16, le=65536)
    """Messages that may wait here; what is beyond is lost and counted as a gap."""


class Charts(Source):
    """A subscription. It outlives the other node: rows come again when that is back."""

    Settings: ClassVar[type[SourceSettings]] = ChartsSettings
    settings: ChartsSettings

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        super().__init__(settings, array)
        self._subscription: Subscription | None = None
        self._chart = self.settings.chart or array.name
        self._waves = Waves(array, self.settings.ranges)
        self._seq = 0
        self._heard_at: float | None = None

    @classmethod
    def carried_facts(cls, settings: ChartsSettings) -> CaptureFacts:
        """Rows have no phase, and a delay where their distances mean something."""
        return CaptureFacts(phase="random", delay="absolute" if settings.ranges else "relative")

    @classmethod
    def problems(cls, settings: ChartsSettings) -> list[str]:
        """Whether the keys can be read."""
        try:
            if settings.server_key is not None:
                load_public(settings.server_key)
            subscribe(settings.endpoint, key=settings.key, server_key=settings.server_key).close()
        except SetupError as error:
            return [str(error)]
        return []

    def open(self) -> None:
        """Subscribe.

        Raises
        ------
        SetupError
            If the endpoint is none, or a key cannot be read.
        """
        told = self.settings
        self._subscription = subscribe(
            told.endpoint, self._chart, queue=told.queue_messages, key=told.key, server_key=told.server_key
        )
        self.rejected = self._subscription.rejected

    def recv(self, timeout: float) -> CsiBlock | None:
        """The rows of the next message, a frame each; None if none came within `timeout` seconds."""
        assert self._subscription is not None
        update = self._subscription.recv(timeout)
        if update is None:
            return None
        self._heard_at = time.monotonic()
        self._seq += self._subscription.gap
        if update.method.theta == FUSION:
            self.rejected.add("fused", len(update))
            self.complaint = f"the chart {update.array} is fused already: it has no directions of one array"
            return None
        good = self._waves.usable(update)
        if not good.all():
            self.rejected.add("no_direction", int(np.count_nonzero(~good)))
            update = update.take(good)
        if not len(update):
            return None
        csi = self._waves.frames(update)
        position = update.position
        block = CsiBlock(self.array.name, self._seq, update.ue, update.time_ns, csi, position)
        self._seq += len(block)
        return block

    def close(self) -> None:
        """Disconnect."""
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None

    def details(self) -> dict[str, Any]:
        """The other node, and what has been heard of it."""
        heard = self._subscription
        return {
            "endpoint": self.settings.endpoint,
            "chart": self._chart,
            "messages_lost": 0 if heard is None else heard.lost,
            "restarts": 0 if heard is None else heard.restarts,
            "connected": self._heard_at is not None,
        }


class Waves:
    """Rows of an array's chart as frames of that array.

    Parameters
    ----------
    array
        The other node's array.
    ranges
        Whether its distances mean something.
    """

    def __init__(self, array: ArrayGeometry, ranges: bool) -> None:
        self._array, self._ranges = array, ranges
        self._elements = array.element_positions()
        self._wave_numbers = 2 * np.pi * array.frequencies_hz / array.light_speed_m_s
        around = self._elements - array.centre_m
        spread = float(np.linalg.svd(around, compute_uv=False)[0]) / math.sqrt(array.antennas)
        self.shape = (array.antennas, array.subcarriers)
        self._per_radian = (2 * np.pi / array.wavelength_m * spread) ** 2
        self._per_metre = float(np.var(self._wave_numbers))
        self._noise = np.random.default_rng(0)

    def usable(self, update: ChartUpdate) -> NDArray[np.bool_]:
        """Which rows (K,) say a direction, and a distance where those count."""
        good = np.isfinite(self._directions(update)).all(axis=1)
        listed = _listed(update)
        if self._ranges:
            good = good & np.isfinite(update.rho) & (update.rho > 0) & (update["relative"] == 0)
        return np.asarray(good | listed, np.bool_)

    def frames(self, update: ChartUpdate) -> NDArray[np.complex64]:
        """Frames complex64 (K, N_R, N_S) of rows that are usable.

        Without paths the power falls with the distance as in free space, so that what counts is where a wave
        comes from.
        """
        listed = _listed(update)
        if listed.any():
            found = np.empty((len(update), *self.shape), np.complex64)
            found[listed] = self._of_paths(update.take(listed))
            if not listed.all():
                found[~listed] = self.frames(update.take(~listed))
            return found
        rho = update.rho if self._ranges else np.full(len(update), FAR_M)
        places = self._array.centre_m + rho[:, None] * (self._directions(update) @ self._array.frame)
        away = np.linalg.norm(places[:, None] - self._elements, axis=2)
        phase = away[:, :, None] * self._wave_numbers
        wave = np.exp(-1j * (phase % (2 * np.pi)))
        shape = (2, *wave.shape)
        noise = self._noise.standard_normal(shape) / math.sqrt(2)
        level = np.sqrt(self._noise_power(update))[:, None, None]
        near = np.maximum(rho, 1.0)[:, None, None]
        heard = (wave + level * (noise[0] + 1j * noise[1])) / near
        return np.asarray(heard, np.complex64)

    def _of_paths(self, update: ChartUpdate) -> NDArray[np.complex128]:
        """Frames of rows with paths: these, and noise of what power they leave.

        What the strongest paths leave has nothing in common with them, nor with what they would be a little
        aside: neither has the noise, which so makes the paths less sure, but does not move them.
        """
        array, paths = self._array, PathList.unpacked(update["paths"])
        known = np.isfinite(update.rho) & (update.rho > 0) & (update["relative"] == 0)
        far = np.where(known, np.maximum(update.rho, NEAREST_M), FAR_M)
        elements = (self._elements - array.centre_m) @ array.frame.T
        geometry = (elements, far, array.frequencies_hz, array.carrier_hz, array.light_speed_m_s)
        waves = paths.waves(*geometry)
        around = [waves, *(one.waves(*geometry) - waves for one in paths.moved())]
        wave = np.einsum("kp,kpns->kns", paths.amplitude, waves)
        left = np.clip(1 - np.mean(np.abs(wave) ** 2, axis=(1, 2)), LEAST_NOISE, MOST_NOISE)
        noise = self._noise.standard_normal((2, *wave.shape)) / math.sqrt(2)
        rest = _without(noise[0] + 1j * noise[1], np.concatenate(around, axis=1))
        heard = wave + np.sqrt(left)[:, None, None] * rest
        return np.asarray(10 ** (paths.level_db / 20)[:, None, None] * heard)

    def _directions(self, update: ChartUpdate) -> NDArray[np.float64]:
        """Own unit vectors (K, 3); of a line, whose cone is one, those in the plane that it looks along."""
        if self._array.is_line:
            zero = np.zeros(len(update))
            return np.column_stack([np.cos(update.theta), zero, np.sin(update.theta)])
        azimuth, elevation = update["azimuth"], np.nan_to_num(update["elevation"])
        flat = np.cos(elevation)
        return np.column_stack([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)])

    def _noise_power(self, update: ChartUpdate) -> NDArray[np.float64]:
        """By how much a wave of power 1 no longer fits one deviation away: that much noise (K,) is added."""
        angle = update["theta_std"] if self._array.is_line else update["azimuth_std"]
        found = self._per_radian * angle**2
        if self._ranges:
            found = found + self._per_metre * np.nan_to_num(update["rho_std"]) ** 2
        return np.clip(np.where(np.isfinite(found), found, UNKNOWN_NOISE), LEAST_NOISE, MOST_NOISE)


def _listed(update: ChartUpdate) -> NDArray[np.bool_]:
    """Which rows (K,) carry paths."""
    return np.asarray(np.isfinite(update["paths"]).all(axis=1), np.bool_)


def _without(noise: NDArray[np.complex128], waves: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Noise (K, N, S) without what it has in common with waves (K, W, N, S)."""
    flat, rows = noise.reshape(len(noise), -1, 1), waves.reshape(*waves.shape[:2], -1)
    size = np.linalg.norm(rows, axis=2, keepdims=True)
    rows = rows / np.maximum(size, 1e-9 * size.max(initial=1e-300))
    gram = rows.conj() @ rows.swapaxes(1, 2) + 1e-4 * np.eye(rows.shape[1])
    common = rows.swapaxes(1, 2) @ np.linalg.solve(gram, rows.conj() @ flat)
    return np.asarray((flat - common).reshape(noise.shape))
