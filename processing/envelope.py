"""Decay measured as an envelope of amplitudes or powers, and test for deflections without a sign."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import log10, nan, pi
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.damping import DampingTerms, fit_damping
from processing.swing import estimate_noise
from processing.units import nanoseconds, seconds

_ROUNDING_ERROR = 1e-9
_NOT_DESCRIBED = 2.0
"""Chi-square per degree of freedom at which the error of the model equals the noise. Noise alone exceeds it
once in 30 envelopes of twelve values and once in 90,000 of sixty."""


@dataclass(frozen=True, slots=True)
class EnvelopeDecay:
    """Decay of an envelope, with time constants of the amplitude (those of the power are half as long).

    `initial` and `floor` are the amplitude at the first sample and of the noise floor (NaN if the end shows
    none), in the samples' unit; `noise` is the scatter of the samples. `tau_s` is the time constant of a
    single exponential; `u_tau_s` includes its variation over the fall. `first_s` and `last_s` are those at a
    quarter and three quarters of the fall (in its logarithm). `damping` is the dependence on the amplitude.
    """

    samples: int
    noise: float
    initial: float
    floor: float
    tau_s: float
    u_tau_s: float
    chi2_per_dof: float
    first_s: float
    last_s: float
    damping: DampingTerms

    @property
    def changes(self) -> bool:
        """Whether one time constant does not describe the fall."""
        return max(self.damping.constant.probability, self.damping.quadratic.probability) >= 0.95

    @property
    def described(self) -> bool:
        """Whether constant, linear and quadratic damping together describe the fall."""
        return self.damping.chi2_per_dof <= _NOT_DESCRIBED

    def quality_factor(self, frequency_hz: float) -> tuple[float, float]:
        """Quality factor pi f tau with its standard uncertainty."""
        return pi * frequency_hz * self.tau_s, pi * frequency_hz * self.u_tau_s


def fit_envelope(times_s: Floats, values: Floats, *, decibel: bool) -> EnvelopeDecay:
    """Fit the damping of an envelope, and a noise floor if its end shows one.

    Parameters
    ----------
    times_s : (n,) ascending
    values : (n,) amplitudes in any unit, or powers in dB (`decibel`); NaN is left out

    Raises
    ------
    DataError
        Fewer than 12 values, amplitudes that are not positive, or values that do not fall.
    """
    good = np.isfinite(values)
    t, y = times_s[good] - times_s[0], values[good]
    # computed values have no noise: their scatter about the fit replaces it
    noise = max(estimate_noise(nanoseconds(t), y), _ROUNDING_ERROR * float(np.max(np.abs(y), initial=0.0)))
    damping = fit_damping(t, y, np.full(len(y), noise), decibel=decibel, floor=True)
    quarters = damping.amplitudes(5)
    ends_s = damping.time_constant_s(quarters[[1, 3]])[0]

    def shown(amplitude: float) -> float:
        if not amplitude > 0:
            return nan
        return 20.0 * log10(amplitude) if decibel else amplitude

    return EnvelopeDecay(
        samples=len(y),
        noise=noise,
        initial=shown(damping.first),
        floor=shown(damping.floor),
        tau_s=damping.exponential.value,
        u_tau_s=damping.exponential.standard_uncertainty,
        chi2_per_dof=damping.exponential_chi2_per_dof,
        first_s=float(ends_s[0]),
        last_s=float(ends_s[1]),
        damping=damping,
    )


_FEWEST_CYCLES: Final = 8
"""Fewest cycles, and fewest samples per cycle, from which a shape is judged."""
_MOST_CYCLES: Final = 16
_PHASES: Final = np.arange(72) / 72
"""Phases of a cycle that are tried, in periods."""
_LARGEST_SQUARES_RATIO: Final = 0.2
"""Largest ratio of the squares that a rectified sinusoid and a sinusoid leave, if the first fits better."""
_LARGEST_SCATTER: Final = 0.04
"""Largest scatter about the rectified shape, relative to the range of a cycle."""
_MAX_ZERO_VALUE: Final = 0.1
"""Values, relative to the largest, that count as zero because of the sampling."""
_MAX_RANGE_RATIO: Final = 0.75
"""Largest ratio of last to first range that counts as a decay."""
_LARGEST_MOVE: Final = 0.1
"""Largest move of constant turning points, relative to the fall of the other side."""
_LARGEST_ZERO_FRACTION: Final = 0.35
"""Largest fraction of samples near zero; a sensor that is blind for one side of the motion has half."""


def unsigned_period_s(times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> float:
    """Period of an oscillation x if the values are |x|, x² or another even function of x; otherwise NaN.

    |x| has cusps at zero. In an even function the turning points of one side stay, the others approach them.
    """
    good = np.isfinite(values)
    times_s, values = seconds(times_ns[good]), values[good]
    if len(values) < _FEWEST_CYCLES**2:
        return np.nan
    times_s = times_s - times_s[0]
    even_s = np.linspace(0.0, times_s[-1], len(times_s))
    steps = np.diff(np.interp(even_s, times_s, values))
    spectrum = np.abs(np.fft.rfft(steps * np.hanning(len(steps))))
    at = int(np.argmax(spectrum[1:-1])) + 1
    before, here, after = spectrum[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    cycles = at + (0.5 * (before - after) / bend if bend else 0.0)
    if not _FEWEST_CYCLES <= cycles <= len(values) / _FEWEST_CYCLES:
        return np.nan
    period_s = float(times_s[-1] / cycles)
    edges = np.searchsorted(times_s, period_s * np.arange(int(cycles) + 1))
    parts = [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a >= _FEWEST_CYCLES]
    if len(parts) < _FEWEST_CYCLES:
        return np.nan
    each = [values[part] for part in parts]
    is_unsigned = (
        _returns_to_zero(each)
        or _one_side_is_constant(each)
        or _has_cusps([(times_s[part] / period_s, values[part]) for part in parts])
    )
    return 2.0 * period_s if is_unsigned else np.nan


def _returns_to_zero(parts: list[NDArray[np.float64]]) -> bool:
    """Whether the values of a decay return to zero in every cycle and never cross it."""
    ends = np.array([(part.min(), part.max()) for part in parts])
    if np.abs(ends[:, 0]).max() > np.abs(ends[:, 1]).max():
        ends = -ends[:, ::-1]
    third = len(ends) // 3
    (first_low, first), (last_low, last) = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    stands = (
        abs(first_low) < _MAX_ZERO_VALUE * first
        and abs(last_low) < _MAX_ZERO_VALUE * last
        and 0 < last < _MAX_RANGE_RATIO * first
    )
    at_zero = np.mean(
        [np.mean(np.abs(part) < _MAX_ZERO_VALUE * np.abs(part).max()) for part in parts[:third]]
    )
    return bool(stands and at_zero < _LARGEST_ZERO_FRACTION)


def _one_side_is_constant(parts: list[NDArray[np.float64]]) -> bool:
    """Whether the turning points of one side are constant while those of the other approach them.

    This is so for the cosine of an angle, a distance to a point beside the swing, and light behind a slit.
    """
    ends = np.array([(part.min(), part.max()) for part in parts])
    third = len(ends) // 3
    first, last = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    span, fell = np.ptp(first), np.ptp(first) - np.ptp(last)
    if not fell > (1.0 - _MAX_RANGE_RATIO) * span:
        return False
    moved = np.abs(last - first)
    side = int(np.argmin(moved))
    near = np.mean([np.mean(np.abs(part - first[side]) < _MAX_ZERO_VALUE * span) for part in parts[:third]])
    return bool(moved[side] < _LARGEST_MOVE * fell and near < _LARGEST_ZERO_FRACTION)


def _has_cusps(parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> bool:
    """Whether a rectified sinusoid fits the cycles (times in periods, values) better than a sinusoid."""
    largest = sorted(parts, key=lambda part: -float(np.ptp(part[1])))[:_MOST_CYCLES]
    left = np.array(
        [
            [_mean_square(cycles, values, shape) / np.ptp(values) ** 2 for shape in (_rectify, _sinusoid)]
            for cycles, values in largest
            if np.ptp(values) > 0
        ]
    )
    if len(left) < _FEWEST_CYCLES:
        return False
    rectified, sinusoid = np.median(left, axis=0)
    return bool(rectified < min(_LARGEST_SQUARES_RATIO * sinusoid, _LARGEST_SCATTER**2))


def _rectify(cycles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.abs(np.sin(np.pi * cycles))


def _sinusoid(cycles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.cos(2.0 * np.pi * cycles)


def _mean_square(
    cycles: NDArray[np.float64], values: NDArray[np.float64], shape: Callable[..., NDArray[np.float64]]
) -> float:
    """Mean square residual from a shape at its best phase, with a straight line added to it."""
    columns = np.stack(
        [
            np.broadcast_to(column, (len(_PHASES), len(cycles)))
            for column in (1.0, cycles - cycles[0], shape(cycles - _PHASES[:, None]))
        ],
        axis=-1,
    )
    rest = values - (columns @ (np.linalg.pinv(columns) @ values)[..., None])[..., 0]
    return float(np.min(np.mean(rest**2, axis=-1)))
