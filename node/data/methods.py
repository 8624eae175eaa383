"""Names of the estimation methods."""

from __future__ import annotations

from typing import Literal

ThetaMethod = Literal["bartlett", "mvdr", "minnorm", "music", "joint"]
RhoMethod = Literal["bartlett", "mvdr", "minnorm", "music", "joint", "isq", "lr"]
