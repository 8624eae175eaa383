"""What an estimator can be told, and which values make sense."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

SPECTRAL: Final = ("bartlett", "mvdr", "minnorm", "music")
AMPLITUDE: Final = ("isq", "lr")
JOINT: Final = "joint"


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How theta and rho are estimated; the keyword arguments of `ChartEstimator`.

    Parameters
    ----------
    theta
        "bartlett", "mvdr", "minnorm" or "music" on the angle manifold.
    rho
        One of these on the delay manifold, or "isq" or "lr" from the amplitude; theta = rho = "joint" looks
        for the direct path on both manifolds at once.
    averaging, memory_frames
        "mean" weighs all frames of a UE alike; "exponential" forgets, so that `memory_frames` frames
        effectively count.
    signal_order, order_threshold
        Signal subspace of MUSIC and Min-Norm: a fixed order, "threshold" (eigenvalues above this fraction of
        the largest) or "mdl".
    forward_backward
        Average each covariance with its conjugate mirror image.
    loading
        Diagonal loading of MVDR, as a fraction of the mean eigenvalue.
    theta_step_deg, rho_step_m
        Grid before refinement; None is as coarse as the refinement allows.
    rho_max_m
        Farthest range that is searched, but never beyond the unambiguous one.
    newton_steps
        Steps from the grid's peak to the true one; 0 keeps the grid's resolution.
    amplitude
        Behind isq and lr: "debiased" power, "coherent" mean (as published) or "noisy" mean of |h|.
    lr_train_ues, lr_log_range
        LR is fitted to the first so many UEs whose position is known; to log(rho) instead of rho.
    isq_reference
        (distance in m, sum of amplitudes there) puts ISQ to scale; else known positions do, else nothing.
    phase
        Of a UE's channel from frame to frame, for the joint method: "steady", "random" or found out ("auto").
    forget_after_s, max_ues
        UEs unseen for so long are forgotten; at most so many are kept, the longest unseen makes room.

    Raises
    ------
    ValueError
        If a value is out of range; the message begins with the argument's name.
    """

    theta: str = "bartlett"
    rho: str = "bartlett"
    averaging: str = "exponential"
    memory_frames: float = 32.0
    signal_order: int | Literal["threshold", "mdl"] = 1
    order_threshold: float = 0.1
    forward_backward: bool = False
    loading: float = 0.05
    theta_step_deg: float | None = None
    rho_step_m: float | None = None
    rho_max_m: float = 1000.0
    newton_steps: int = 4
    amplitude: str = "debiased"
    lr_train_ues: int = 256
    lr_log_range: bool = False
    isq_reference: tuple[float, float] | None = None
    phase: str = "auto"
    forget_after_s: float | None = None
    max_ues: int = 100_000

    def __post_init__(self) -> None:
        self._one_of("theta", (*SPECTRAL, JOINT))
        self._one_of("rho", (*SPECTRAL, JOINT, *AMPLITUDE))
        if (self.theta == JOINT) != (self.rho == JOINT):
            name, other = ("rho", "theta") if self.theta == JOINT else ("theta", "rho")
            raise ValueError(f"{name} must be 'joint' as {other} is, not {getattr(self, name)!r}")
        self._one_of("averaging", ("mean", "exponential"))
        self._one_of("phase", ("auto", "steady", "random"))
        self._one_of("amplitude", ("debiased", "coherent", "noisy"))
        order = self.signal_order
        if order not in ("threshold", "mdl") and not (isinstance(order, int) and order >= 1):
            raise ValueError(f"signal_order must be at least 1, 'threshold' or 'mdl', not {order!r}")
        self._within("order_threshold", 0, 1, strict=True)
        self._within("loading", 0)
        self._within("newton_steps", 0, 20)
        self._within("lr_train_ues", 2)
        self._within("max_ues", 1)
        self._within("memory_frames", 1)
        for name in ("theta_step_deg", "rho_step_m", "rho_max_m", "forget_after_s"):
            self._within(name, 0, strict=True)
        if self.isq_reference is not None and not all(math.isfinite(v) and v > 0 for v in self.isq_reference):
            raise ValueError(f"isq_reference must be two positive numbers, not {self.isq_reference}")

    @property
    def decay(self) -> float:
        """Weight of a frame relative to the next one of its UE.

        With weights decay**age the effective number of frames, (sum w)^2 / sum w^2, tends to
        (1 + decay) / (1 - decay): `memory_frames`.
        """
        if self.averaging == "mean":
            return 1.0
        return max((self.memory_frames - 1) / (self.memory_frames + 1), 0.0)

    def _one_of(self, name: str, allowed: tuple[str, ...]) -> None:
        value = getattr(self, name)
        if value not in allowed:
            raise ValueError(f"{name} must be one of {', '.join(allowed)}, not {value!r}")

    def _within(self, name: str, low: float, high: float = math.inf, *, strict: bool = False) -> None:
        value = getattr(self, name)
        if value is None:
            return
        if not math.isfinite(value) or not (low < value < high if strict else low <= value <= high):
            bounds = f"above {low}" if strict else f"at least {low}"
            if high < math.inf:
                bounds += f" and {'below' if strict else 'at most'} {high}"
            raise ValueError(f"{name} must be {bounds}, not {value}")
