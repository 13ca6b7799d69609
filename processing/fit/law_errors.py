"""What a law does not describe of a decay, as values: how far it lies from it, what changed meanwhile."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from processing.quantity import PLAIN, Quantity

MISFIT_SEEN = 10.0
"""Difference of -2 ln L from a law without errors above which they are seen: chance about 0.3 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfit:
    """How far a law lies from a decay.

    Attributes
    ----------
    loss, duration, waveform
        Relative standard deviations of the errors of the law's losses, durations and harmonics; 0 where they
        are not seen.
    against_law
        Increase of -2 ln L for the law without errors.
    widened
        Factor by which the uncertainty of each parameter grew, by its name; empty where nothing is seen.
    """

    loss: float = 0.0
    duration: float = 0.0
    waveform: float = 0.0
    against_law: float = 0.0
    widened: Annotated[Mapping[str, float], PLAIN] = field(default_factory=dict)

    @property
    def seen(self) -> bool:
        return self.against_law > MISFIT_SEEN


class ChangeKind(StrEnum):
    """What changed during a run."""

    KNOCK = "knock"
    FRICTION = "friction"
    PERIOD = "period"


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One change during a run.

    `time_s` is on the clock of the turning points, `half_cycle` the index of the first one after it. `size`
    is relative, of a knock to the amplitude whatever its phase; `gain` is by how much -2 ln L is smaller
    with it.
    """

    kind: ChangeKind
    half_cycle: int
    time_s: Annotated[float, Quantity("", "when it happened", unit="s")]
    size: float
    u_size: float
    gain: float

    @property
    def text(self) -> str:
        """In one line."""
        # no power of ten above 100 %
        percent, u = float(f"{100 * self.size:.2g}"), float(f"{100 * self.u_size:.1g}")
        what = {
            ChangeKind.KNOCK: f"a knock moves the swing by {percent:g} ± {u:g} % of its amplitude",
            ChangeKind.FRICTION: f"the friction changes by {percent:+g} ± {u:g} %: the contact slipped "
            "or was touched",
            ChangeKind.PERIOD: f"the period changes by {percent:+g} ± {u:g} %: something shifted",
        }[self.kind]
        return f"at half-cycle {self.half_cycle} ({self.time_s:.0f} s on the clock of the data) {what}"
