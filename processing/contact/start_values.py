"""Start values of the paper's law from a decay: Eq. 5 fitted, Eq. 6 searched over its exponent."""

from typing import NamedTuple

from processing.contact.decay_fit import fit_decay
from processing.contact.exponent_search import DecayStart, PeriodStart, period_start
from processing.periods import FEWEST_PERIODS, full_periods, mean_period, reference_amplitude
from processing.swing import TurningPoints


class StartValues(NamedTuple):
    """Start values in units of the reference amplitude; `periods` in order of rising chi-square."""

    decay: DecayStart
    periods: list[PeriodStart]
    mean_period_s: float


def start_values(points: TurningPoints, rho: float, *, drag: bool) -> StartValues:
    """Start values of an exact fit; `rho` is R/a times the reference amplitude."""
    reference = reference_amplitude(points)
    mean = mean_period(points)
    decay, _ = fit_decay(points, reference, mean, drag, "soft_l1")
    periods = full_periods(points)
    if len(periods.where) >= FEWEST_PERIODS:
        starts = period_start(
            points.amplitude[periods.where] / reference, periods.period_s, periods.u_period_s, rho
        )
    else:
        starts = [PeriodStart(mean, 0.3, 1e-3)]
    b, p, c, *rest = decay.values.tolist()
    return StartValues(DecayStart(rest[-1], b, p, c, rest[0] if drag else 0.0), starts, mean)
