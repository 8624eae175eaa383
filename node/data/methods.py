"""Names of the estimation methods."""

from __future__ import annotations

from typing import Final, Literal

SpectralMethod = Literal["bartlett", "mvdr", "minnorm", "music"]
AmplitudeMethod = Literal["isq", "lr"]
ThetaMethod = Literal[SpectralMethod, "joint", "none"]
RhoMethod = Literal[SpectralMethod, "joint", AmplitudeMethod, "auto", "none"]

FUSION: Final = "fusion"
"""What rows of fused or tracked positions say instead: those are in world metres."""
