"""What a node is going to do: its settings with every class found and the array settled."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from chachart.config.load import NodeSettings
from chachart.config.pairing import FeedSettings
from chachart.config.registry import sink_class, source_class
from chachart.config.settings import (
    TIME_TOLERANCE_S,
    ArraySettings,
    QualitySettings,
    StateSettings,
    WorkersSettings,
)
from chachart.node.data.alerts import AlertSettings
from chachart.node.data.errors import SetupError
from chachart.node.data.extras import missing
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.placement import Placement, placed_arrays
from chachart.node.data.zones import ZoneSettings
from chachart.node.estimation.estimator import ChartEstimator
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options
from chachart.node.files.placements import load_placements
from chachart.node.files.url_folders import folder_at
from chachart.node.net.security import SecuritySettings, security_problems
from chachart.node.runtime.capacity import capacity_problems, frame_problems
from chachart.node.runtime.processor import estimator_of
from chachart.sinks.base import Sink, SinkSettings
from chachart.sources.base import Source, SourceSettings

BLOCK_BYTES = 32 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Feed:
    """A source with its settings, and the arrays whose frames it gives."""

    source: type[Source]
    settings: SourceSettings
    arrays: tuple[ArrayGeometry, ...]

    @property
    def name(self) -> str:
        """What people call it: its arrays."""
        return ", ".join(array.name for array in self.arrays)

    @classmethod
    def of(cls, settings: FeedSettings) -> Feed:
        """The feed that carries out `settings`.

        Raises
        ------
        SetupError
            If there is no such source, or its arrays are not clear.
        """
        source = source_class(settings.source.type)
        if len(settings.arrays) > 1:
            return cls(source, settings.source, tuple(_described(array) for array in settings.arrays))
        first = resolve_array(next(iter(settings.arrays), None), source, settings.source)
        return cls(source, settings.source, (first, *source.carried_others(settings.source)))


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything a node needs to start.

    Attributes
    ----------
    array, others
        The first array, and all others, as they are described.
    source, source_settings, sinks
        Classes with their settings; the source is the first one.
    further
        The sources after the first, each with its arrays.
    placements
        What `[fusion] calibration` says of the arrays.
    estimator, workers, quality, state, security, fusion, tracking, zones, alerts
        The other sections of the configuration.
    time_tolerance_s
        How far the time of a live frame may be from this host's.
    """

    array: ArrayGeometry
    source: type[Source]
    source_settings: SourceSettings
    estimator: Options
    workers: WorkersSettings
    quality: QualitySettings
    state: StateSettings
    sinks: tuple[tuple[type[Sink], SinkSettings], ...]
    security: SecuritySettings = field(default_factory=SecuritySettings)
    time_tolerance_s: float = TIME_TOLERANCE_S
    others: tuple[ArrayGeometry, ...] = ()
    fusion: FusionOptions = field(default_factory=FusionOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    further: tuple[Feed, ...] = ()
    placements: tuple[Placement, ...] = ()
    zones: tuple[ZoneSettings, ...] = ()
    alerts: tuple[AlertSettings, ...] = ()

    @classmethod
    def of(cls, settings: NodeSettings) -> Plan:
        """The plan that carries out `settings`.

        Raises
        ------
        SetupError
            If a source or sink is unknown, the array is not clear, or the calibration of arrays does not fit.
        """
        first, *further = _feeds(settings)
        estimator = settings.estimator
        for feed in (first, *further):
            estimator = estimator.obeying(feed.source.carried_facts(feed.settings))
        arrays = [array for feed in (first, *further) for array in feed.arrays]
        tolerances = [array.time_tolerance_s for feed in settings.feeds for array in feed.arrays]
        return cls(
            first.arrays[0],
            first.source,
            first.settings,
            estimator,
            settings.workers,
            settings.quality,
            settings.state,
            tuple((sink_class(sink.type), sink) for sink in settings.sinks),
            settings.security,
            max(tolerances, default=TIME_TOLERANCE_S),
            tuple(arrays[1:]),
            settings.fusion,
            settings.tracking,
            tuple(further),
            _placements(settings.fusion, arrays),
            settings.zones,
            settings.alerts,
        )

    @property
    def feeds(self) -> tuple[Feed, ...]:
        """All sources, each with its arrays."""
        own = len(self.others) - sum(len(feed.arrays) for feed in self.further)
        return (Feed(self.source, self.source_settings, (self.array, *self.others[:own])), *self.further)

    @property
    def placed(self) -> tuple[ArrayGeometry, ...]:
        """All arrays, where calibration says that they are."""
        return placed_arrays((self.array, *self.others), self.placements)

    @property
    def sources(self) -> str:
        """What the sources are called in messages."""
        return " and ".join(f'source "{name}"' for name in dict.fromkeys(f.settings.type for f in self.feeds))

    def problems(self) -> list[str]:
        """What would keep the node from starting, as far as can be told without starting it."""
        found = [*security_problems(self.security)]
        if self.workers.runtime == "ray":
            found += [f'[workers] runtime = "ray": {problem}' for problem in missing("ray")]
        for feed in self.feeds:
            found += [*feed.settings.exposure(self.security), *feed.source.problems(feed.settings)]
        for sink, settings in self.sinks:
            found += settings.exposure(self.security) + sink.problems(settings)
        found += self._shared_endpoints()
        found += self._state_problems()
        found += self.misfits()
        return list(dict.fromkeys(found))

    def misfits(self) -> list[str]:
        """Why the array cannot be charted, or several cannot be fused or their UEs tracked."""
        if self.several() is None:
            alone = (
                "[fusion] calibration is of several arrays or tracked UEs; one array has [array] calibration"
            )
            return [*([alone] if self.placements else []), *estimator_problems(self.array, self.estimator)]
        try:
            estimator_of(self.array, self.estimator.keywords() | {"max_ues": 1}, self.several())
        except ValueError as error:
            return [f"[fusion]: {error}"]
        return []

    def _state_problems(self) -> list[str]:
        directory = self.state.directory
        if directory is None:
            return []
        try:
            found = folder_at(directory).problems()
        except SetupError as error:
            return [f"[state] directory: {error}"]
        return [f"[state] directory = {directory!r}: {problem}" for problem in found]

    def _shared_endpoints(self) -> Iterator[str]:
        """Endpoints that are free now, but that two parts of this node want to listen on."""
        taken: dict[str, str] = {}
        parts: list[SourceSettings | SinkSettings] = [feed.settings for feed in self.feeds]
        parts += [settings for _, settings in self.sinks]
        for part in parts:
            endpoint = part.listens_on()
            if endpoint in taken:
                yield f'"{taken[endpoint]}" and "{part.type}" cannot both listen on {endpoint}'
            elif endpoint is not None:
                taken[endpoint] = part.type

    @property
    def block_frames(self) -> int:
        """Frames in a block; never more than the UEs that a worker may hold, or than a message should."""
        largest = max(array.antennas * array.subcarriers for array in (self.array, *self.others))
        fit = max(1, BLOCK_BYTES // (8 * largest))
        return min(self.workers.block_frames, int(self.worker_estimator()["max_ues"]), fit)

    def several(self) -> dict[str, Any] | None:
        """What a worker needs besides the array for fusion or tracking; None where there is neither."""
        if not self.others and self.tracking.motion == "off":
            return None
        fusion = self.fusion.model_dump(mode="json")
        if self.fusion.area_m is None and self.fusion.outline_m is None:
            areas = (feed.source.carried_area(feed.settings) for feed in self.feeds)
            fusion["area_m"] = next((area for area in areas if area is not None), None)
        return {
            "others": [other.as_dict() for other in self.others],
            "fusion": fusion,
            "tracking": self.tracking.model_dump(mode="json"),
            "placements": [place.as_dict() for place in self.placements],
        }

    def worker_estimator(self) -> dict[str, Any]:
        """ChartEstimator's arguments for each worker, which gets its share of the UEs.

        A hash spreads UEs over workers only on average: a worker has room for four standard deviations more.
        """
        count, whole = self.workers.count, self.estimator
        share = whole.max_ues / count
        spread = 0.0 if count == 1 else 4 * math.sqrt(share)
        values = whole.model_dump(mode="json", exclude_unset=True)
        values["max_ues"] = min(whole.max_ues, math.ceil(share + spread))
        values["lr_train_ues"] = max(2, math.ceil(whole.lr_train_ues / count))
        return values


def resolve_array(
    configured: ArraySettings | None, source: type[Source], source_settings: SourceSettings
) -> ArrayGeometry:
    """The array that the source measures with; a calibration in `[array]` goes before one that it carries.

    What is dead adds up.

    Raises
    ------
    SetupError
        If neither the configuration nor the source describes one, or both do and differ.
    """
    carried = source.carried_array(source_settings)
    if configured is None:
        if carried is None:
            raise SetupError(
                f'[array] is missing: source "{source_settings.type}" does not say what array it has'
            )
        return carried
    array = _described(configured)
    if carried is not None and configured.element_spacing_m is None and array.is_line:
        half_wave = array.wavelength_m / 2  # of the carrier: what went without saying in older recordings
        if math.isclose(carried.element_spacing_m, half_wave, rel_tol=1e-6):
            array = replace(array, element_spacing_m=half_wave)
    if carried is not None and (differences := array.mismatches(carried)):
        raise SetupError(
            f'[array] does not fit source "{source_settings.type}": {"; ".join(differences)} '
            "(leave [array] out to take the source's)"
        )
    return array if carried is None else array.completed(carried)


def _described(configured: ArraySettings) -> ArrayGeometry:
    try:
        return replace(configured.geometry(), calibration=configured.correction())
    except ValueError as error:
        raise SetupError(f"[array]: {error}") from None


def _placements(fusion: FusionOptions, arrays: list[ArrayGeometry]) -> tuple[Placement, ...]:
    try:
        found = () if fusion.calibration is None else load_placements(Path(fusion.calibration))
        placed_arrays(arrays, found)
    except ValueError as error:
        raise SetupError(f"[fusion] calibration: {error}") from None
    return found


def _feeds(settings: NodeSettings) -> Iterator[Feed]:
    """All of them; of several, a mistake says whose it is."""
    for feed in settings.feeds:
        try:
            yield Feed.of(feed)
        except SetupError as error:
            if len(settings.feeds) == 1:
                raise
            whose = ", ".join(array.name for array in feed.arrays) or feed.source.type
            raise SetupError(f"source of {whose}: {error}") from None


def check(settings: NodeSettings) -> list[str]:
    """Every mistake in `settings` that can be told without starting the node."""
    try:
        return Plan.of(settings).problems()
    except SetupError as error:
        return list(dict.fromkeys([*_problems_apart_from_array(settings), str(error)]))


def _problems_apart_from_array(settings: NodeSettings) -> Iterator[str]:
    yield from security_problems(settings.security)
    for feed in settings.feeds:
        yield from feed.source.exposure(settings.security)
        yield from source_class(feed.source.type).problems(feed.source)
    for sink in settings.sinks:
        yield from sink.exposure(settings.security)
        yield from sink_class(sink.type).problems(sink)


def estimator_problems(array: ArrayGeometry, estimator: Options) -> list[str]:
    """Why no estimator can be made from these settings for this array; nothing if one can."""
    if problems := list(frame_problems(array)):
        return problems  # nothing of such a size is tried out
    try:
        smallest = ChartEstimator(array, **(estimator.keywords() | {"max_ues": 1}))
    except ValueError as error:
        return [f"[estimator]: {error}"]
    return list(capacity_problems(smallest, estimator))
