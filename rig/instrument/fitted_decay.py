"""A decay beside what a fit says of it, as it is drawn while the run goes on."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from acquisition.record.topics import RecordedFittedPoint


@dataclass(frozen=True, slots=True)
class FittedDecay:
    """Half-cycles of a run and the fit to them, thinned; times are those of the frames' clock.

    Residuals are (data − fit) in standard uncertainties of the data. A full period stands at the turning
    point in its middle.
    """

    turn_times_ns: Sequence[int] = ()
    fitted_rad: Sequence[float] = ()
    amplitude_residual: Sequence[float] = ()
    period_times_ns: Sequence[int] = ()
    fitted_period_s: Sequence[float] = ()
    period_residual: Sequence[float] = ()

    def points(self, time_ns: int) -> list[RecordedFittedPoint]:
        """The same as messages of a record, of a fit at this time."""
        turns = zip(self.turn_times_ns, self.fitted_rad, self.amplitude_residual, strict=True)
        periods = zip(self.period_times_ns, self.fitted_period_s, self.period_residual, strict=True)
        return [
            *(RecordedFittedPoint(time_ns, at, value, left) for at, value, left in turns),
            *(
                RecordedFittedPoint(time_ns, at, period_s=value, period_residual=left)
                for at, value, left in periods
            ),
        ]


def decay_of(points: Iterable[RecordedFittedPoint]) -> FittedDecay:
    """A decay beside its fit, from the messages of one fit."""
    turns = [one for one in points if not math.isnan(one.amplitude_residual)]
    periods = [one for one in points if not math.isnan(one.period_residual)]
    return FittedDecay(
        [one.turn_time_ns for one in turns],
        [one.amplitude_rad for one in turns],
        [one.amplitude_residual for one in turns],
        [one.turn_time_ns for one in periods],
        [one.period_s for one in periods],
        [one.period_residual for one in periods],
    )
