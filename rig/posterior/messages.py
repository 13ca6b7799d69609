"""What goes to the process that fits, and what comes back."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from calibration import Axes
from processing.contact import DEFAULT_LAW, PendulumOnBall
from processing.deflections import Deflections
from processing.estimate import Estimate
from processing.fit import NO_EVIDENCE, Evidence
from processing.least_squares import Loss
from processing.swing import Swing
from rig.instrument import FittedDecay


class FittedModel(NamedTuple):
    """The exact fit as the final analysis makes it.

    `clock_rate` is how many true seconds pass in one of the swings' clock, `axes` are the pendulum's.
    """

    pendulum: PendulumOnBall
    drag: bool = True
    loss: Loss = "linear"
    clock_rate: float = 1.0
    axes: Axes | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys of what is estimated, without the run's first amplitude and time."""
        return DEFAULT_LAW.fit_names(calibrated=True, drag=self.drag)[:-2]


class Asked(NamedTuple):
    """What has come since the last message: half-cycles without a flag, and the deflections, in rad.

    All of the same `run` are fitted, restrained by the `evidence`.
    """

    run: int
    swings: Sequence[Swing]
    deflections: Deflections
    evidence: Evidence = NO_EVIDENCE


class FittedParameters(NamedTuple):
    """Parameters by key, or why there are none; `cpu_s` is the processor time of the fit.

    `decay` are the half-cycles beside the fit, None without one.
    """

    estimates: Mapping[str, Estimate]
    problem: str
    cpu_s: float
    decay: FittedDecay | None = None
