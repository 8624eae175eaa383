"""TOML and `--set` overrides in, validated settings out; all mistakes at once, with what would be right."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from chachart.config.describe import allowed, literal_values, nested_model, toml
from chachart.config.overrides import LABELS, apply
from chachart.config.pairing import FeedSettings, paired
from chachart.config.registry import Kind, available, settings_class, suggestion
from chachart.config.settings import ArraySettings, QualitySettings, StateSettings, WorkersSettings
from chachart.config.shipped import LAB, find
from chachart.node.data.alerts import AlertSettings
from chachart.node.data.errors import SetupError
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Settings
from chachart.node.data.zones import ZoneSettings
from chachart.node.estimation.fit import misfits, unreachable
from chachart.node.estimation.fusion.options import FusionOptions, TrackingOptions
from chachart.node.estimation.options import Options
from chachart.node.net.security import SecuritySettings
from chachart.sinks.base import SinkSettings
from chachart.sources.base import SourceSettings

_WHAT = ("array", "source", "estimator", "fusion", "tracking")
SECTIONS = (*_WHAT, "workers", "quality", "state", "security", "zones", "alerts", "sinks")

AnySettings = TypeVar("AnySettings", bound=Settings)
Location = tuple[str | int, ...]


class ConfigError(SetupError):
    """A configuration with mistakes; the message has one line for each.

    Attributes
    ----------
    mistakes
        The lines.
    """

    def __init__(self, mistakes: Sequence[str]) -> None:
        super().__init__("\n".join(mistakes))
        self.mistakes = tuple(mistakes)


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """What a node is told.

    Attributes
    ----------
    feeds
        The sources, each with its arrays.
    estimator, workers, quality, state, sinks, security, fusion, tracking, zones, alerts
        The other sections of the configuration.
    """

    feeds: tuple[FeedSettings, ...]
    estimator: Options
    workers: WorkersSettings
    quality: QualitySettings
    state: StateSettings
    sinks: tuple[SinkSettings, ...]
    security: SecuritySettings = field(default_factory=SecuritySettings)
    fusion: FusionOptions = field(default_factory=FusionOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    zones: tuple[ZoneSettings, ...] = ()
    alerts: tuple[AlertSettings, ...] = ()

    @property
    def source(self) -> SourceSettings:
        """The first source."""
        return self.feeds[0].source

    @property
    def array(self) -> ArraySettings | None:
        """The first source's first array; None where it must carry its own."""
        return next(iter(self.feeds[0].arrays), None)


def load(path: Path | None = None, overrides: Sequence[str] = (), sinks: Sequence[str] = ()) -> NodeSettings:
    """The settings in a TOML file, changed by `section.key=value`s.

    Parameters
    ----------
    path
        The file, or the name of a shipped one (`lab` if None).
    overrides
        The changes.
    sinks
        Types of sinks to add at their defaults; what is there already is not added again.

    Raises
    ------
    ConfigError
        If the file cannot be read, or it or an override has mistakes: all of them.
    """
    name = str(path or LAB.name)
    try:
        document = _read(find(path or LAB))
    except SetupError as error:
        raise ConfigError(str(error).splitlines()) from None
    there = document.setdefault("sinks", []) if sinks else []
    if isinstance(there, list):
        types = [sink.get("type") for sink in there if isinstance(sink, dict)]
        there += [{"type": sink} for sink in dict.fromkeys(sinks) if sink not in types]
    return settings_of(document, overrides, name)


def settings_of(document: dict[str, Any], overrides: Sequence[str], name: str) -> NodeSettings:
    """The settings in a parsed TOML document, which is changed on the way; `name` is where it comes from.

    Raises
    ------
    ConfigError
        If it or an override has mistakes: all of them.
    """
    return _Loader(name, document, overrides).settings()


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError([f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}"]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError([f"{path}: is not TOML: {error}"]) from None


class _Loader:
    """One pass over one document, collecting mistakes."""

    def __init__(self, name: str, document: dict[str, Any], overrides: Sequence[str]) -> None:
        self.name = name
        self.document = document
        self.mistakes: list[str] = []
        self.overridden, wrong = apply(document, overrides)
        self.mistakes += wrong

    def settings(self) -> NodeSettings:
        """The settings.

        Raises
        ------
        ConfigError
            If anything is wrong.
        """
        for section in self.document:
            if section not in SECTIONS:
                hint = suggestion(section, list(SECTIONS))
                self._wrong((section,), f"there is no such section, only {', '.join(SECTIONS)}{hint}")
        arrays = [self._validate(ArraySettings, *one) for one in self._repeated("array")]
        sources = [self._component("source", *one) for one in self._repeated("source")]
        estimator = self._section(Options, "estimator")
        workers = self._section(WorkersSettings, "workers")
        quality = self._section(QualitySettings, "quality")
        security = self._section(SecuritySettings, "security")
        state = self._section(StateSettings, "state")
        fusion = self._section(FusionOptions, "fusion")
        tracking = self._section(TrackingOptions, "tracking")
        zones = [self._validate(ZoneSettings, *one) for one in self._listed("zones")]
        alerts = [self._validate(AlertSettings, *one) for one in self._listed("alerts")]
        sinks = [self._component("sink", *one) for one in self._listed("sinks")]
        self._named("zones", zones)
        self._named("alerts", alerts)
        self._zones_of(alerts, [zone.name for zone in zones if zone])
        geometries = [self._geometry(array) for array in arrays if array]
        if estimator and len(geometries) == 1 and (geometry := geometries[0]):
            for key, problem in (*misfits(estimator, geometry), *unreachable(estimator, geometry)):
                self._wrong(("estimator", key), problem, getattr(estimator, key))
        if state is not None and state.resume and state.directory is None:
            self._wrong(("state", "resume"), "directory must be set to resume from", state.resume)
        if estimator is None or workers is None or quality is None or state is None or self.mistakes:
            raise ConfigError(self.mistakes)
        try:
            feeds = paired(cast(list[SourceSettings], sources), cast(list[ArraySettings], arrays))
        except ValueError as error:
            raise ConfigError([f"{self.name}: {error}"]) from None
        return NodeSettings(
            feeds,
            estimator,
            workers,
            quality,
            state,
            tuple(cast(SinkSettings, sink) for sink in sinks),
            cast(SecuritySettings, security),
            cast(FusionOptions, fusion),
            cast(TrackingOptions, tracking),
            tuple(cast(list[ZoneSettings], zones)),
            tuple(cast(list[AlertSettings], alerts)),
        )

    def _wrong(self, location: Location, problem: str, value: Any = None) -> None:
        origin = "--set " if location in self.overridden else f"{self.name}: "
        shown = f" = {_brief(value)}" if value is not None else ""
        self.mistakes.append(f"{origin}{self._place(location)}{shown}: {problem}")

    def _place(self, location: Location) -> str:
        """A location as people write it: a sink by its type, or its place where that does not say which."""
        if len(location) > 1 and isinstance(number := location[1], int):
            section, label = str(location[0]), LABELS[str(location[0])]
            labels = [table.get(label) for table in self.document[section]]
            name, key = labels[number], ".".join(map(str, location[2:]))
            if isinstance(name, str) and key != label and labels.count(name) == 1:
                return f"{section}.{name}.{key}"
            return f"[[{section}]] number {number + 1}, {key}"
        return ".".join(map(str, location))

    def _repeated(self, section: str) -> list[tuple[Location, dict[str, Any]]]:
        """The table of a section, or all of them where it is repeated, each with where it is."""
        tables = self.document.get(section, {})
        if isinstance(tables, dict):
            return [((section,), tables)] if section in (*self.document, "source") else []
        if isinstance(tables, list) and tables and all(isinstance(table, dict) for table in tables):
            return [((section, n), table) for n, table in enumerate(tables)]
        self._wrong((section,), f"must be a table: [{section}] on a line of its own, its keys below", tables)
        return []

    def _table(self, section: str) -> dict[str, Any] | None:
        table = self.document.get(section, {})
        if isinstance(table, dict):
            return table
        self._wrong((section,), f"must be a table: [{section}] on a line of its own, its keys below", table)
        return None

    def _listed(self, section: str) -> list[tuple[Location, dict[str, Any]]]:
        """The tables of a section that may have any number of them, each with where it is."""
        tables = self.document.get(section, [])
        if isinstance(tables, list) and all(isinstance(table, dict) for table in tables):
            return [((section, n), table) for n, table in enumerate(tables)]
        self._wrong((section,), f"must be a list of tables: [[{section}]] in front of each, its keys below")
        return []

    def _named(self, section: str, tables: Sequence[ZoneSettings | AlertSettings | None]) -> None:
        """Each must have a name of its own."""
        names = [table.name for table in tables if table]
        for name in sorted({name for name in names if names.count(name) > 1}):
            self._wrong((section,), f'"{name}" is there more than once; each needs a name of its own')

    def _zones_of(self, alerts: Sequence[AlertSettings | None], zones: list[str]) -> None:
        for n, alert in enumerate(alerts):
            if alert and alert.zone is not None and alert.zone not in zones:
                hint = suggestion(alert.zone, zones)
                self._wrong(("alerts", n, "zone"), f"there is no such zone in [[zones]]{hint}", alert.zone)

    def _section(self, model: type[AnySettings], section: str) -> AnySettings | None:
        table = self._table(section)
        return None if table is None else self._validate(model, (section,), table)

    def _component(self, kind: Kind, where: Location, table: dict[str, Any]) -> Settings | None:
        location = (*where, "type")
        name = table.get("type")
        names = ", ".join(f'"{n}"' for n in available(kind))
        if name is None:
            self._wrong(location, f"is missing; it must be one of {names}")
            return None
        if not isinstance(name, str):
            self._wrong(location, f"must be one of {names}", name)
            return None
        try:
            model = settings_class(kind, name)
        except SetupError as error:
            self._wrong(location, str(error), name)
            return None
        return self._validate(model, where, table)

    def _geometry(self, array: ArraySettings) -> ArrayGeometry | None:
        try:
            return array.geometry()
        except ValueError as error:
            several = isinstance(self.document["array"], list)
            self._wrong((f"array.{array.name}" if several else "array",), str(error))
            return None

    def _validate(
        self, model: type[AnySettings], where: Location, table: dict[str, Any]
    ) -> AnySettings | None:
        """The instance; None with mistakes noted. Read as JSON, so that 4 is no text and "4" no number."""
        try:
            return model.model_validate_json(json.dumps(table, default=str), strict=True)
        except ValidationError as error:
            seen: set[Location] = set()
            for detail in error.errors():
                location, field, owner = _find(model, detail["loc"])
                if location not in seen:
                    seen.add(location)
                    blamed = location and detail["type"] == "value_error"  # may be at its default
                    value = detail["input"] if blamed else _value(table, location) if location else None
                    self._wrong((*where, *location), _problem(detail, value, field, owner), value)
            return None


def _find(model: type[Settings], loc: Location) -> tuple[Location, FieldInfo | None, type[BaseModel]]:
    """Where an error is in terms of keys (branches of unions left out), its field, and whose it is."""
    location: list[str] = []
    field: FieldInfo | None = None
    owner: type[BaseModel] = model
    for step in loc:
        if field and (nested := nested_model(field.annotation)):
            owner = nested
        elif field:
            break
        if isinstance(step, str) and (step in owner.model_fields or step == loc[-1]):
            location.append(step)
            field = owner.model_fields.get(step)
    return tuple(location), field, owner


def _problem(detail: ErrorDetails, value: Any, field: FieldInfo | None, owner: type[BaseModel]) -> str:
    if detail["type"] == "extra_forbidden":
        keys = list(owner.model_fields)
        return f"there is no such key{suggestion(detail['loc'][-1], keys)}; the keys are {', '.join(keys)}"
    if detail["type"] in ("value_error", "assertion_error") or field is None:
        return detail["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    if value is None:
        return f"is missing; it must be {allowed(field)}"
    return f"must be {allowed(field)}{suggestion(value, list(map(str, literal_values(field.annotation))))}"


def _brief(value: Any) -> str:
    text = toml(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _value(table: Any, location: Location) -> Any:
    for step in location:
        try:
            table = table[step]
        except (KeyError, IndexError, TypeError):
            return None
    return table
