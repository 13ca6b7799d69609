"""What goes to the process that fits, and what comes back."""

from collections.abc import Mapping
from typing import NamedTuple

from processing.contact import DEFAULT_LAW, PendulumOnBall
from processing.estimate import Estimate
from processing.fit import NO_EVIDENCE, Evidence
from processing.least_squares import Loss
from processing.swing import TurningPoints


class FittedModel(NamedTuple):
    """The exact fit as the final analysis makes it."""

    pendulum: PendulumOnBall
    drag: bool = True
    loss: Loss = "linear"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys of what is estimated, without the run's first amplitude and time."""
        return DEFAULT_LAW.fit_names(calibrated=True, drag=self.drag)[:-2]


class Fitted(NamedTuple):
    """What is fitted at one time: turning points, and what restrains the fit beside them."""

    points: TurningPoints
    evidence: Evidence = NO_EVIDENCE


class FittedParameters(NamedTuple):
    """Parameters by key, or why there are none; `cpu_s` is the processor time of the fit."""

    estimates: Mapping[str, Estimate]
    problem: str
    cpu_s: float
