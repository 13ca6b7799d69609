"""The swing of a pendulum at rest, which the ground keeps up: its quadratures in every period."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.errors import DataError

_FEWEST_PERIODS = 8
_PERIODS_S = (1.5, 15.0)
"""Range in which the period is looked for."""
_FEWEST_SAMPLES = 8
"""In a period."""
_BIN_S = 0.1


class SwingAtRest(NamedTuple):
    """Times and deflections in tenths of a second, the period in s, and how many whole ones there are."""

    time_s: Floats
    deflection: Floats
    period_s: float
    periods: int

    def with_period(self, period_s: float) -> "SwingAtRest":
        """The same, of another period."""
        return self._replace(period_s=period_s, periods=int(np.ptp(self.time_s) / period_s))


def swing_at_rest(time_s: Floats, deflection: Floats) -> SwingAtRest:
    """The deflections of a pendulum at rest (NaN where there is no spot), and its period.

    Raises DataError for fewer than eight periods.
    """
    seen = np.isfinite(deflection)
    time_s, deflection = _binned(time_s[seen], deflection[seen])
    span_s = float(np.ptp(time_s)) if len(time_s) else 0.0
    if span_s < _FEWEST_PERIODS * _PERIODS_S[0]:
        raise DataError(f"{span_s:.3g} s of the pendulum at rest are too short to see the ground")
    period_s = _period(time_s, deflection, span_s)
    periods = int(span_s / period_s)
    if periods < _FEWEST_PERIODS:
        raise DataError(
            f"the spot at rest moves mostly with a period of {period_s:.3g} s; {span_s:.3g} s contain "
            f"{periods} periods, and the ground needs {_FEWEST_PERIODS}"
        )
    return SwingAtRest(time_s, deflection, period_s, periods)


def _binned(time_s: Floats, deflection: Floats) -> tuple[Floats, Floats]:
    """Means over tenths of a second: nothing here is faster."""
    if not len(time_s):
        return time_s, deflection
    _, start, count = np.unique(np.floor(time_s / _BIN_S), return_index=True, return_counts=True)
    return np.add.reduceat(time_s, start) / count, np.add.reduceat(deflection, start) / count


def _period(time_s: Floats, deflection: Floats, span_s: float) -> float:
    """Where the changes of the deflections hold most power, to a twentieth of the resolution.

    Of their changes, because pointing and air wander the more the slower, and would be taken for a long
    period.
    """
    frequency_hz = np.arange(1 / _PERIODS_S[1], 1 / _PERIODS_S[0], 0.05 / span_s)
    change, middle_s = np.diff(deflection), 0.5 * (time_s[1:] + time_s[:-1])
    change -= np.mean(change)
    found = [abs(np.exp(2j * np.pi * one * middle_s) @ change) for one in frequency_hz]
    return float(1 / frequency_hz[np.argmax(found)])


def quadratures_of(rest: SwingAtRest, deflections: Floats) -> tuple[NDArray[np.complex128], float]:
    """Amplitudes of cosine and, times i, of sine in each period (periods, series), of (times, series).

    Beside an offset and a slope; and the variance of either amplitude of the first series, by what these
    leave of neighbouring samples.
    """
    time_s, period_s = rest.time_s - rest.time_s[0], rest.period_s
    out = np.empty((rest.periods, deflections.shape[1]), dtype=np.complex128)
    variance = np.empty(rest.periods)
    phase = 2 * np.pi * time_s / period_s
    columns = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), phase])
    for k in range(rest.periods):
        inside = (time_s >= k * period_s) & (time_s < (k + 1) * period_s)
        if np.count_nonzero(inside) < _FEWEST_SAMPLES:
            raise DataError(
                f"{np.count_nonzero(inside)} samples in a period of {period_s:.3g} s at rest are too few"
            )
        fitted = np.linalg.lstsq(columns[inside], deflections[inside], rcond=None)[0]
        out[k] = fitted[0] + 1j * fitted[1]
        left = np.diff(deflections[inside, 0] - columns[inside] @ fitted[:, 0])
        variance[k] = np.mean(left**2) / (np.count_nonzero(inside) - 4)
    return out, float(np.median(variance))


def without_decay(turning: NDArray[np.complex128]) -> Floats:
    """(periods - 1, 2) steps less what goes with the oscillation: its decay, a period a little off."""
    step, middle = np.diff(turning), 0.5 * (turning[1:] + turning[:-1])
    left = step - middle * np.vdot(middle, step) / np.vdot(middle, middle)
    left *= np.sqrt(len(step) / (len(step) - 1))
    return np.column_stack([left.real, left.imag])
