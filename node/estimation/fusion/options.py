"""What fusion and tracking can be told: `[fusion]` and `[tracking]`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from chachart.node.data.settings import Settings

Corner = tuple[float, float]


class FusionOptions(Settings):
    """`[fusion]`: how the frames of several arrays become one position a UE."""

    name: str = Field("fused", min_length=1)
    """What rows of fused positions say in `array`."""
    clock: Literal["auto", "shared", "offset", "own"] = "auto"
    """`shared`: delays are absolute. `offset`: the arrays share a clock, UEs do not. `own`: angles only."""
    height_m: float | Literal["free"] | None = None
    """World height of the UEs; `free`: searched; not set: `height_m` below the first array, or 0."""
    slope: tuple[float, float] = (0.0, 0.0)
    """dz/dx and dz/dy of the ground that UEs are on; height_m is then that at x = y = 0."""
    heights_m: tuple[float, float] = (0.0, 3.0)
    """Lowest and highest world height where it is free."""
    area_m: tuple[float, float, float, float] | None = Field(None, examples=[(0.0, 0.0, 20.0, 15.0)])
    """Where UEs can be: x and y of the lower corner, then of the higher; not set: round the arrays."""
    outline_m: Annotated[tuple[Corner, ...], Field(min_length=3)] | None = Field(
        None, examples=[((0.0, 0.0), (20.0, 0.0), (20.0, 12.0))]
    )
    """Corners of a polygon that UEs are inside, as a building's; besides area_m or instead of it."""
    window_ms: float = Field(20.0, gt=0)
    """Frames of a UE that follow each other within this time are of one transmission."""

    calibration: str | None = Field(None, min_length=1, examples=["arrays.toml"])
    """A file of `chachart calibrate --arrays`: where the arrays really are, and how late their clocks."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        area = self.area_m
        if area is not None and not (area[0] < area[2] and area[1] < area[3]):
            raise ValueError(f"area_m must be a lower and a higher corner, not {list(area)}")
        if not self.heights_m[0] < self.heights_m[1]:
            raise ValueError(f"heights_m must be a lower and a higher z, not {list(self.heights_m)}")
        return self


class TrackingOptions(Settings):
    """`[tracking]`: UEs that move."""

    motion: Literal["off", "static", "walk", "drive"] = "off"
    """How UEs move: `walk` and `drive` include standing; `off`: every position stands for itself."""
    lag: int = Field(0, ge=0, le=100)
    """How many positions later a position is told, so that those count as well; 0: at once."""
