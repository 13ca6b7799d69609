"""How far a law lies from a decay, as a value."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from processing.quantity import PLAIN

MISFIT_SEEN = 10.0
"""Difference of -2 ln L from a law without errors above which they are seen: chance about 0.3 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """How far a law lies from a decay.

    Attributes
    ----------
    loss, duration, waveform
        Relative standard deviations of the errors of the law's losses, durations and harmonics; 0 where they are
        not seen.
    against_law
        By how much -2 ln L of the law without errors is larger.
    widened
        By how many times the uncertainty of each parameter grew, by its name; empty where nothing is seen.
    """

    loss: float = 0.0
    duration: float = 0.0
    waveform: float = 0.0
    against_law: float = 0.0
    widened: Annotated[Mapping[str, float], PLAIN] = field(default_factory=dict)

    @property
    def seen(self) -> bool:
        return self.against_law > MISFIT_SEEN
