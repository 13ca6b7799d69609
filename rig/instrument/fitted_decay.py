"""A decay beside what a fit says of it, as it is drawn while the run goes on."""

from collections.abc import Sequence
from dataclasses import dataclass


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
