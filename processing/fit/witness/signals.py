"""What a witness of the ground recorded, as signals whose gains are fitted.

The witness's response is not known. Near the pendulum's frequency two numbers describe it: a gain, and one
for the same record with every phase turned by a quarter; and two more where gain or phase change within the
band over which a half-swing feels the ground.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil

import numpy as np

from processing.arrays import Flags, Floats
from processing.errors import DataError
from processing.fit.known_drive import Signals

_COARSEST = 0.25
"""Longest step between samples, in periods: a parabola through three of them still follows a swing."""
_FINEST = 1 / 80
"""Step, in periods, to which finer samples are averaged; it takes 3e-4 of the gain."""
_GAP = 1.6
"""Steps between samples above which some are missing."""
_GUARD = 0.5
"""Periods beside a gap that what was put into it still changes."""
_DRIFT = 1 / 8
"""Frequency, in those of the pendulum, below which a record is its instrument's drift."""
_PADDED = 16
"""Periods by which a record is mirrored at its ends."""


@dataclass(frozen=True, eq=False)
class Witness:
    """Samples of an instrument beside the rig, or not far from it.

    Times (n,) in s on the clock of the turning points, rising; values (n, components) in any unit, NaN where
    missing; a name for each component.
    """

    time_s: Floats
    value: Floats
    names: tuple[str, ...]

    def delayed(self, by_s: float, drift: float = 0.0, about_s: float = 0.0) -> "Witness":
        """The same with times later by `by_s`, and by `drift` more for each second after `about_s`."""
        return replace(self, time_s=self.time_s + by_s + drift * (self.time_s - about_s))

    def between(self, first_s: float, last_s: float) -> "Witness":
        """The samples within these times."""
        low, high = np.searchsorted(self.time_s, (first_s, last_s)).tolist()
        return replace(self, time_s=self.time_s[low:high], value=self.value[low:high])


class Kind(StrEnum):
    """How a signal follows from a component."""

    GAIN = "gain"
    QUADRATURE = "quadrature"
    SLOPE = "slope of the gain"
    SLOPE_QUADRATURE = "slope of the quadrature"


PAIR = (Kind.GAIN, Kind.QUADRATURE)
SLOPES = (Kind.SLOPE, Kind.SLOPE_QUADRATURE)


def signals_of(witness: Witness, period_s: float) -> Signals:
    """Every component's four signals, in the order of `Kind`.

    Raises DataError for samples that are too few or too far apart.
    """
    time, value, step_s = _even(witness, period_s)
    good = np.all(np.isfinite(value), axis=1)
    if np.count_nonzero(good) * step_s < 4 * period_s:
        raise DataError(
            f"the witness has {np.count_nonzero(good) * step_s:.3g} s of samples beside the run; at least "
            f"four periods ({4 * period_s:.3g} s) are needed"
        )
    filled = np.column_stack([np.interp(time, time[good], one[good]) for one in value.T])
    padding = min(ceil(_PADDED * period_s / step_s), len(time) - 1)
    filled -= filled.mean(axis=0)
    padded = np.pad(filled, ((padding, padding), (0, 0)), mode="reflect", reflect_type="odd")
    padded -= np.linspace(padded[0], padded[-1], len(padded))
    spectrum = np.fft.rfft(padded, axis=0)
    nu = np.fft.rfftfreq(len(padded), step_s)[:, None] * period_s
    spectrum *= 1.0 - np.exp(-((nu / _DRIFT) ** 2))
    slope = np.clip(nu - 1.0, -1.0, 1.0)
    turned = -1j * spectrum
    kinds = np.stack([spectrum, turned, slope * spectrum, slope * turned], axis=2)
    found = np.fft.irfft(kinds.reshape(len(nu), -1), len(padded), axis=0)
    found = found[padding : padding + len(time)]
    usable = ~_near(~good, ceil(_GUARD * period_s / step_s))
    return Signals(time[usable], np.ascontiguousarray(found[usable]), _GAP * step_s)


def plain_signals(witness: Witness, period_s: float) -> Signals:
    """Every component as it is, but for its drift."""
    return signals_of(witness, period_s).only([one * len(Kind) for one in range(len(witness.names))])


def _even(witness: Witness, period_s: float) -> tuple[Floats, Floats, float]:
    """Times, values (NaN where missing) and step of samples at one rate."""
    time, value = witness.time_s, witness.value
    if len(time) < 3:
        raise DataError(f"the witness has {len(time)} samples beside the run: their times do not overlap")
    steps = np.diff(time)
    step_s = float(np.median(steps))
    if step_s > _COARSEST * period_s:
        raise DataError(
            f"the witness has a sample every {step_s:.3g} s; the pendulum's period of {period_s:.3g} s needs "
            f"one every {_COARSEST * period_s:.2g} s at least"
        )
    count = round((time[-1] - time[0]) / step_s) + 1
    even = time[0] + step_s * np.arange(count)
    before = np.clip(np.searchsorted(time, even, side="right") - 1, 0, len(time) - 2)
    lost = steps[before] > _GAP * step_s
    found = np.column_stack([np.interp(even, time, one) for one in value.T])
    found[lost] = np.nan
    together = int(_FINEST * period_s / step_s)
    if together < 2:
        return even, found, step_s
    kept = count // together * together
    even = even[:kept].reshape(-1, together).mean(axis=1)
    return even, found[:kept].reshape(len(even), together, -1).mean(axis=1), step_s * together


def _near(lost: Flags, guard: int) -> Flags:
    """Which samples are at most `guard` from a lost one."""
    count = np.concatenate([[0], np.cumsum(lost)])
    places = np.arange(len(lost))
    low, high = np.maximum(places - guard, 0), np.minimum(places + guard + 1, len(lost))
    return np.asarray(count[high] > count[low])
