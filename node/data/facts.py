"""What is known of CSI besides its array: what its phase and delay mean, and who its UEs are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self, get_args

Phase = Literal["steady", "random"]
"""`random`: every frame has a phase of its own, common to all antennas, so frames must not be added up."""
Delay = Literal["absolute", "relative"]
"""`relative`: every frame has a delay of its own, common to all antennas: no distance comes from delay."""


@dataclass(frozen=True, slots=True)
class CaptureFacts:
    """Facts of a capture, as recordings carry them.

    Attributes
    ----------
    phase, delay
        Whether frames share a phase, and a time to measure delay from.
    power
        What the amplitude means: `raw` (as in the file), `rssi` (mean |h|^2 is the received power in mW),
        `agc` (the receiver's gain is undone).
    senders
        Names of UEs by id, as MAC addresses.
    """

    phase: Phase = "steady"
    delay: Delay = "absolute"
    power: str = "raw"
    senders: Mapping[int, str] = field(default_factory=dict)

    @classmethod
    def together(cls, each: Iterable[CaptureFacts]) -> CaptureFacts:
        """What holds for frames of several captures: the least that any of them says."""
        facts = list(each)
        return cls(
            "random" if any(one.phase == "random" for one in facts) else "steady",
            "relative" if any(one.delay == "relative" for one in facts) else "absolute",
            facts[0].power if len({one.power for one in facts}) == 1 else "raw",
            {ue: name for one in facts for ue, name in one.senders.items()},
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; `from_dict` reads them back."""
        senders = {str(ue): name for ue, name in self.senders.items()}
        return {"phase": self.phase, "delay": self.delay, "power": self.power, "senders": senders}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build from `as_dict`'s values; what is missing has its default, what is unknown is passed over.

        Raises
        ------
        ValueError
            If a value does not fit.
        """
        phase, delay = values.get("phase", "steady"), values.get("delay", "absolute")
        senders = values.get("senders", {})
        if phase not in get_args(Phase) or delay not in get_args(Delay) or not isinstance(senders, dict):
            raise ValueError(f"not facts of a capture: phase {phase!r}, delay {delay!r}")
        names = {int(ue): str(name) for ue, name in senders.items()}
        return cls(phase, delay, str(values.get("power", "raw")), names)
