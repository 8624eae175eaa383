"""What every sink is: somewhere charts, quality reports, status reports or raw CSI go.

The runtime gives each sink a thread and a bounded queue of its own and calls it from that thread only, so a
slow sink never holds up the estimates; what its queue could not take is counted by the runtime. Sinks with
`wants_csi` run beside the source and get its blocks; all others run beside the collector and get its reports.
"""

from __future__ import annotations

from abc import ABC
from pathlib import Path
from typing import Any, ClassVar, Protocol

from chachart.node.data.chart import ChartUpdate
from chachart.node.data.counters import Counters
from chachart.node.data.csi import CsiBlock
from chachart.node.data.facts import CaptureFacts
from chachart.node.data.geometry import ArrayGeometry
from chachart.node.data.settings import Settings
from chachart.node.net.security import SecuritySettings


class SinkSettings(Settings):
    """What every sink's table in a configuration has."""

    type: str
    """Which sink."""

    def listens_on(self) -> str | None:
        """The one endpoint that it takes for itself; None where it takes none, or any that is free."""
        return None

    def exposure(self, security: SecuritySettings) -> list[str]:
        """Why people who should not could reach it, as mistakes of the configuration."""
        return []


class NodeAccess(Protocol):
    """What a sink may ask of the node it belongs to; safe to call from any thread.

    What goes on to the feeder or to the worker that has the UE is asked by its own name.
    """

    def ask(self, operation: str, arguments: dict[str, Any]) -> dict[str, Any]:
        """The answer of the node's processes to a request.

        Raises
        ------
        RequestError
            If it is answered with an error, or not in time.
        """

    def chart(self) -> ChartUpdate | None:
        """The whole chart as it stands, or None before the first estimate."""

    def status(self) -> dict[str, Any]:
        """The latest status report."""

    def quality(self) -> dict[str, Any] | None:
        """The latest quality report, or None where no reference position is known."""

    def ues(self) -> dict[str, Any]:
        """`{"ues": [...]}`: the chart's rows, one map each."""

    def chart_columns(self) -> dict[str, Any]:
        """The whole chart: the body of a chart message (protocol 1) and `geometry`, the array; or {}."""

    def spectrum(self, ue: int) -> dict[str, Any]:
        """`theta_grid_rad`, `theta_spectrum`, `rho_grid_m`, `rho_spectrum`, `theta`, `rho`, ... of one UE.

        Raises
        ------
        RequestError
            If the UE is not on the chart, or nobody answers in time.
        """
        return self.ask("spectrum", {"ue": ue})

    def antennas(self, ue: int) -> dict[str, Any]:
        """Level and phase by antenna and by subcarrier of the UE's newest frame, and its paths.

        `antenna_db`, `antenna_phase`, `tone_db`, `tone_phase` of the frame as it came in, `ue`, `time_ns`,
        and the picture of `chachart.node.estimation.angle_delay`; {} until a frame comes that was asked for.
        """
        return self.ask("antennas", {"ue": ue})

    def set_method(self, theta: str, rho: str) -> dict[str, str]:
        """Estimate with these methods from the next block on; {theta, rho}.

        Raises
        ------
        RequestError
            If they are unknown or do not fit the array, which changes nothing; or if nobody answers in time:
            should the node take the request up later, `status` says so.
        """

    def replay(
        self, *, paused: bool | None = None, speed: float | None = None, at_s: float | None = None
    ) -> dict[str, Any]:
        """Pause, go on, change the speed or jump, where the source is a recording; how it plays now.

        A jump begins the chart anew.

        Raises
        ------
        RequestError
            If the source is no recording, or there is no such time.
        """

    def start_recording(self, path: Path, compression: str = "none") -> dict[str, Any]:
        """Record the CSI that comes in; {on, where, received, dropped, ...}. `compression` is none or zstd.

        Raises
        ------
        RequestError
            If the file cannot be written or a recording runs already; nothing has changed then.
        """
        return self.ask("start_recording", {"path": str(path), "compression": compression})

    def stop_recording(self) -> dict[str, Any]:
        """Close the recording that `start_recording` began; {on, where, received, dropped, ...}.

        Raises
        ------
        RequestError
            If none runs.
        """
        return self.ask("stop_recording", {})


class Sink(ABC):
    """Where charts go. Override what the sink cares about.

    Attributes
    ----------
    Settings
        The settings model of this sink, found by `type`.
    wants_csi
        True for sinks that take the CSI that came in rather than charts.
    lost
        Rows, frames or reports that it took and could not pass on, by reason.
    refused
        What it turned away (peers, requests, messages), by reason.
    security, others, facts
        `[security]`, further arrays whose frames come, and what phase and delay of the frames mean; whoever
        runs the sink sets them before `open`.
    trouble
        Why it cannot do its work at the moment, in one line, or None.
    """

    Settings: ClassVar[type[SinkSettings]]
    wants_csi: ClassVar[bool] = False
    security: SecuritySettings = SecuritySettings()
    others: tuple[ArrayGeometry, ...] = ()
    facts: CaptureFacts = CaptureFacts()

    def __init__(self, settings: Any, array: ArrayGeometry) -> None:
        self.settings = settings
        self.array = array
        self.lost = Counters()
        self.refused = Counters()
        self.trouble: str | None = None

    @classmethod
    def problems(cls, settings: Any) -> list[str]:
        """What would keep the sink from opening, as far as can be told without opening it."""
        return []

    def open(self, node: NodeAccess | None) -> None:
        """Take hold of files and ports; `node` is None for sinks with `wants_csi`.

        Raises
        ------
        SetupError
            If one of them cannot be had.
        """

    def on_csi(self, block: CsiBlock) -> None:
        """A block that came in."""

    def on_chart(self, update: ChartUpdate) -> None:
        """Estimates since the last call; a UE occurs once."""

    def on_quality(self, report: dict[str, Any]) -> None:
        """How good the chart is: `tw`, `ct`, `k`, `ues`, `stress`, `error_m` and their like."""

    def on_status(self, report: dict[str, Any]) -> None:
        """The node's counters and rates."""

    def on_alert(self, event: dict[str, Any]) -> None:
        """What one of `[[alerts]]` has to say.

        `alert`, `on`, `state` (raised or ended), `text`, `ue` and `zone` where it is about them, `ues` (how
        many it stands for), `time_ns`, `number`.
        """

    def on_tick(self) -> None:
        """Called about 20 times a second between the other calls, for whatever must not wait for data."""

    def close(self) -> None:
        """Flush and let go. May be called twice."""

    def where(self) -> str | None:
        """Where a person finds what the sink gives (an endpoint, a file, an address), or None."""
        return None
