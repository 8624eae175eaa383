"""What people want to be told of: `[[alerts]]`."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from chachart.node.data.settings import Settings
from chachart.node.data.zones import Name

LIMITS = {
    "silent": "seconds",
    "error": "metres",
    "tw": "the trustworthiness below which it is raised",
    "ct": "the continuity below which it is raised",
}
"""Alerts that have a limit, and what the limit is."""


class AlertSettings(Settings):
    """`[[alerts]]`: what the page, the publisher, MQTT and Prometheus are told of."""

    name: Name
    """What it is called."""
    on: Literal["enter", "leave", "silent", "tw", "ct", "error", "antenna"]
    """A UE enters or leaves a zone or falls silent; TW, CT or the median error is bad; an antenna is dead."""
    zone: Name | None = None
    """Which of `[[zones]]`; enter and leave need one, silent may have one: UEs last heard in there."""
    ues: tuple[int, ...] | None = Field(None, examples=[(7, 9)], max_length=10_000)
    """Which UEs it is about; not set: all."""
    limit: float | None = Field(None, gt=0)
    """silent: after so many seconds; tw, ct: below that; error: above so many metres."""
    for_s: float = Field(1.0, ge=0, le=86400)
    """It must have been so for so long."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.on in ("enter", "leave") and self.zone is None:
            raise ValueError(f'zone must be set: on = "{self.on}" is about one')
        if self.on in LIMITS and self.limit is None:
            raise ValueError(f'limit must be set for on = "{self.on}": {LIMITS[self.on]}')
        if self.on not in LIMITS and self.limit is not None:
            raise ValueError(f'limit means nothing for on = "{self.on}"')
        if self.on not in ("enter", "leave", "silent") and (self.zone or self.ues) is not None:
            raise ValueError(f'zone and ues mean nothing for on = "{self.on}"')
        return self
