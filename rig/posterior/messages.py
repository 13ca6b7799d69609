"""What goes to the process that fits, and what comes back."""

from collections.abc import Mapping
from typing import NamedTuple

from processing.contact import DEFAULT_LAW, PendulumOnBall
from processing.estimate import Estimate
from processing.least_squares import Loss


class FittedModel(NamedTuple):
    """The exact fit as the final analysis makes it."""

    pendulum: PendulumOnBall
    drag: bool = False
    loss: Loss = "linear"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Keys of what is estimated, without the run's first amplitude and time."""
        return DEFAULT_LAW.fit_names(calibrated=True, drag=self.drag)[:-2]


class FittedParameters(NamedTuple):
    """Parameters by key, or why there are none; `cpu_s` is the processor time of the fit."""

    estimates: Mapping[str, Estimate]
    problem: str
    cpu_s: float
