"""What an estimator can be told: `[estimator]`, and the keywords of `ChartEstimator`."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, TypedDict, Unpack, cast

from pydantic import Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from chachart.node.data.facts import CaptureFacts
from chachart.node.data.methods import AmplitudeMethod, RhoMethod, SpectralMethod, ThetaMethod
from chachart.node.data.settings import Settings

SPECTRAL: Final[tuple[SpectralMethod, ...]] = ("bartlett", "mvdr", "minnorm", "music")
AMPLITUDE: Final[tuple[AmplitudeMethod, ...]] = ("isq", "lr")
JOINT: Final = "joint"
AUTO: Final = "auto"
NONE: Final = "none"

Averaging = Literal["mean", "exponential"]
SignalOrder = Annotated[int, Field(ge=1)] | Literal["threshold", "mdl"]
Amplitude = Literal["debiased", "coherent", "noisy"]
Phase = Literal["auto", "steady", "random"]
Delay = Literal["absolute", "relative"]
Positive = Annotated[float, Field(gt=0)]


class Options(Settings):
    """`[estimator]`: how theta and rho are estimated. The fields are ChartEstimator's keywords."""

    theta: ThetaMethod = "bartlett"
    """Angle method. `joint` goes with rho = "joint" or "auto" only; `none` charts distances alone, along
    broadside."""
    rho: RhoMethod = "bartlett"
    """Distance method: a spectral one across subcarriers, an amplitude one (isq, lr), joint, or `auto`, which
    weighs delays, power and spreads; `none` charts directions alone, on a circle of radius 1."""
    averaging: Averaging = "exponential"
    """`mean` weighs all frames alike (UEs that stand still); `exponential` forgets (UEs that move)."""
    memory_frames: float = Field(32.0, ge=1)
    """Effective number of frames that `exponential` averaging remembers."""
    signal_order: SignalOrder = 1
    """Signal subspace of MUSIC and Min-Norm: a fixed order, an eigenvalue threshold, or MDL."""
    order_threshold: float = Field(0.1, gt=0, lt=1)
    """With signal_order = "threshold": eigenvalues above this fraction of the largest are signal."""
    forward_backward: bool = False
    """Average each covariance with its conjugate mirror image."""
    smoothing: float = Field(1.0, ge=0.5, le=1)
    """Sub-arrays that span so much of a line, of a board's rows and columns and of the band are averaged, for
    coherent echoes; 1: none. Not for Bartlett, which does not mind them."""
    elevation: bool = True
    """Look for azimuth and elevation; false: for azimuth alone, all UEs being at the array's own height."""
    loading: float = Field(0.3, ge=0)
    """Diagonal loading of MVDR, as a fraction of the mean eigenvalue."""
    theta_step_deg: float | None = Field(None, ge=0.01, le=10)
    """Angle grid before refinement; where not set, as coarse as the refinement allows."""
    rho_step_m: float | None = Field(None, ge=0.01)
    """Range grid before refinement; where not set, as coarse as the refinement allows."""
    rho_max_m: float = Field(1000.0, gt=0)
    """Farthest range that is searched; never beyond the unambiguous c / subcarrier_spacing_hz."""
    newton_steps: int = Field(4, ge=0, le=20)
    """Newton steps from the grid's peak to the true one; 0 keeps the grid's resolution."""
    amplitude: Amplitude = "debiased"
    """Amplitude behind isq and lr: noise-debiased power, coherent mean (as published), mean of |h|."""
    lr_train_ues: int = Field(256, ge=2)
    """LR is fitted to the first so many UEs whose position is known."""
    lr_log_range: bool = False
    """LR fits log(rho) instead of rho."""
    isq_reference: tuple[Positive, Positive] | None = None
    """(distance in m, sum of amplitudes there) puts ISQ to scale; else known positions do, else nothing."""
    phase: Phase = "auto"
    """Of a UE's channel from frame to frame, for `joint`: `steady` averages frames, `random` their powers."""
    paths: int = Field(2, ge=1, le=8)
    """With `joint`: so many paths are told apart in a UE's spectrum, and, unless the array is a line, in its
    place where there are echoes."""
    echoes: bool = True
    """Deviations allow for echoes that cannot be told from the path, as in cities; false: for noise alone."""
    path_list: bool = False
    """Rows tell the three strongest paths of a UE's newest frame, for nodes that fuse several (`charts`)."""
    delay: Delay = "absolute"
    """`relative`: a frame's delay is its detection's, not the distance's, as in captures of Wi-Fi tools."""
    forget_after_s: float | None = Field(None, gt=0)
    """UEs unseen for so long leave the chart; not set: never."""
    max_ues: int = Field(100_000, ge=1)
    """At most so many UEs are kept; the one unseen for longest makes room."""

    @classmethod
    def of(cls, **keywords: Unpack[Keywords]) -> Options:
        """The options that keywords say, for code: the first mistake alone, in words of Python.

        Raises
        ------
        ValueError
            If an option's value makes no sense; the message begins with the option's name.
        TypeError
            If there is no such option.
        """
        try:
            return cls(**cast(dict[str, Any], keywords))
        except ValidationError as error:
            first = error.errors()[0]
        name = str(first["loc"][0])
        if first["type"] == "extra_forbidden":
            raise TypeError(f"{name} is not among the options: {', '.join(cls.model_fields)}")
        raise ValueError(f"{name} {first['msg'].replace('Input should', 'must')}, not {first['input']!r}")

    def keywords(self) -> Keywords:
        """What was set, as keywords: those that were left to their defaults are left so."""
        return cast(Keywords, self.model_dump(exclude_unset=True))

    def obeying(self, facts: CaptureFacts) -> Options:
        """These options with what a capture says of phase and delay, where nothing was set."""
        known = {"phase": "random"} if facts.phase == "random" else {}
        known |= {"delay": "relative"} if facts.delay == "relative" else {}
        update = {name: value for name, value in known.items() if name not in self.model_fields_set}
        return self.model_copy(update=update)

    @property
    def decay(self) -> float:
        """Weight of a frame relative to the next one of its UE.

        With weights decay**age the effective number of frames, (sum w)^2 / sum w^2, tends to
        (1 + decay) / (1 - decay): `memory_frames`.
        """
        if self.averaging == "mean":
            return 1.0
        return max((self.memory_frames - 1) / (self.memory_frames + 1), 0.0)

    @model_validator(mode="after")
    def _go_together(self) -> Options:
        jointly = (self.theta == JOINT, self.rho == JOINT)
        if jointly[0] != jointly[1] and self.rho != AUTO:
            name, other = ("rho", "theta") if self.theta == JOINT else ("theta", "rho")
            self._refuse(name, f'must be "joint" as {other} is: the joint method estimates both at once')
        if self.theta == self.rho == NONE:
            self._refuse("rho", 'must not be "none" as theta is: nothing would be left to chart')
        if self.rho_step_m is not None and self.rho_step_m > self.rho_max_m:
            self._refuse("rho_step_m", f"must be at most rho_max_m = {self.rho_max_m:g}")
        return self

    def _refuse(self, name: str, problem: str) -> None:
        kind = PydanticCustomError("value_error", "{problem}", {"problem": problem})
        at: InitErrorDetails = {"type": kind, "loc": (name,), "input": getattr(self, name)}
        raise ValidationError.from_exception_data("Options", [at])


class Keywords(TypedDict, total=False):
    """The fields of `Options`, for type checkers."""

    theta: ThetaMethod
    rho: RhoMethod
    averaging: Averaging
    memory_frames: float
    signal_order: int | Literal["threshold", "mdl"]
    order_threshold: float
    forward_backward: bool
    smoothing: float
    elevation: bool
    loading: float
    theta_step_deg: float | None
    rho_step_m: float | None
    rho_max_m: float
    newton_steps: int
    amplitude: Amplitude
    lr_train_ues: int
    lr_log_range: bool
    isq_reference: tuple[float, float] | None
    phase: Phase
    paths: int
    echoes: bool
    path_list: bool
    delay: Delay
    forget_after_s: float | None
    max_ues: int
