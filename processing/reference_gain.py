"""Gain of the reference, of a swinging pendulum and of one at rest: motion of the pendulum's spot per motion
of the reference.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Complexes, Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.least_squares import FactoredJacobian
from processing.reference_spot import BLOCKS, common_motion, fitted_gain, u_of_blocks
from processing.units import seconds

_MIN_STRETCHES = 10
_MAX_STRETCH_S = 64.0
_MIN_FRAMES = 64
"""Smallest number of frames of a stretch."""
_MAX_LOST_FRACTION = 0.1
"""Largest fraction of lost frames of a stretch that is used."""
_WINDOW = (0.35875, 0.48829, 0.14128, 0.01168)
"""Window of Blackman and Harris: at sidelobes of -92 dB a swing of 1e4 times the beam's motion is gone."""
_STARTS_PER_LENGTH = 4
"""Stretches that begin within the length of one: they overlap, as the window uses only their middles."""
_WEIGHT_ITERATIONS = 4


def gain_while_swinging(
    times_ns: Ints, spot_px: Floats, u_spot_px: Floats, reference_px: Floats, u_reference_px: Floats
) -> Estimate:
    """Gain along one axis of the sensor, of a swinging pendulum; positions (n,) are NaN without a spot.

    The reference's own noise, which would reduce the gain, is subtracted from its power. The uncertainty
    follows from the scatter between parts of the run.

    Raises DataError for too short a run, and for a reference that shows no motion above its noise.
    """
    time_s = seconds(times_ns - times_ns[0])
    has_both = np.all(np.isfinite([spot_px, u_spot_px, reference_px, u_reference_px]), axis=0)
    frames = np.count_nonzero(has_both)
    if frames < _MIN_FRAMES * _MIN_STRETCHES:
        raise DataError(
            f"{frames} frames have both spots; {_MIN_FRAMES * _MIN_STRETCHES} are needed for the gain of the "
            "reference: state reference.gain"
        )
    step_s = float(np.median(np.diff(time_s)))
    even_s = step_s * np.arange(round(time_s[-1] / step_s) + 1)
    presence = np.interp(even_s, time_s, has_both.astype(np.float64))
    length = min(len(even_s) // _MIN_STRETCHES, max(_MIN_FRAMES, round(_MAX_STRETCH_S / step_s)))
    starts = [
        start
        for start in range(0, len(even_s) - length + 1, length // _STARTS_PER_LENGTH)
        if np.mean(presence[start : start + length]) > 1 - _MAX_LOST_FRACTION
    ]
    if len(starts) < BLOCKS:
        raise DataError("too few stretches of the run have both spots: state reference.gain")
    phase = 2 * np.pi * np.arange(length) / length
    window = np.asarray(sum((-1) ** k * a * np.cos(k * phase) for k, a in enumerate(_WINDOW)))

    def spectra(position_px: Floats) -> Complexes:
        even = np.interp(even_s, time_s[has_both], position_px[has_both])
        return _spectra(np.stack([even[start : start + length] for start in starts]), window)

    spot_spectra, reference_spectra = spectra(spot_px), spectra(reference_px)
    noise = float(np.mean(u_reference_px[has_both] ** 2)) * float(np.sum(window**2))
    cross = np.real(np.conj(reference_spectra) * spot_spectra)
    power = np.abs(reference_spectra) ** 2 - noise
    gain = 0.0
    for _ in range(_WEIGHT_ITERATIONS):
        weight = 1 / _means_of_others(np.abs(spot_spectra - gain * reference_spectra) ** 2)
        numerator, denominator = np.sum(cross * weight, axis=1), np.sum(power * weight, axis=1)
        gain = _ratio(numerator, denominator)
    # neighbours overlap, so that each block has several
    u = u_of_blocks(lambda rows: _ratio(numerator[rows], denominator[rows]), len(starts))
    if not (np.sum(denominator) > 0 and np.isfinite(u)):
        raise DataError("the reference shows no motion over its own noise, so that its gain is unknown")
    return Estimate(gain, u)


def _spectra(stretches: Floats, window: Floats) -> Complexes:
    """Spectra (stretches, frequencies) without mean and drift of each, and without the lowest frequency."""
    line = np.linspace(-1.0, 1.0, stretches.shape[1])
    level = stretches.mean(axis=1, keepdims=True)
    slope = (stretches - level) @ line[:, None] / float(line @ line)
    return np.asarray(np.fft.rfft((stretches - level - slope * line) * window)[:, 1:])


def _means_of_others(values: Floats) -> Floats:
    """Means (stretches, frequencies) over the other stretches that do not overlap. A weight from the
    stretch's own noise would favour frequencies at which that is small by chance."""
    index = np.arange(len(values))
    is_apart = np.abs(index[:, None] - index) >= _STARTS_PER_LENGTH
    return np.asarray(is_apart @ values / is_apart.sum(axis=1, keepdims=True))


def _ratio(numerator: Floats, denominator: Floats) -> float:
    total = float(np.sum(denominator))
    return float(np.sum(numerator)) / total if total > 0 else float("nan")


_KNOT_PERIODS = 3.0
"""Number of periods over which the amplitude of a pendulum at rest changes little."""


class ReferenceAtRest(NamedTuple):
    """Effect of the reference along one axis of the sensor, with the pendulum's oscillation removed."""

    before_px: float
    """Standard deviation of the pendulum's spot."""
    factor: Estimate
    """Factor by which that falls if the reference is subtracted, with the stated gain or else with `gain`.
    Its uncertainty follows from parts of the record."""
    gain: Estimate
    """Gain that this record shows."""
    share: float
    """Part of the reference's variance that is motion and not noise."""


def reference_at_rest(
    times_ns: Ints,
    spot_px: Floats,
    u_spot_px: Floats,
    reference_px: Floats,
    u_reference_px: Floats,
    *,
    gain: float | None,
    period_s: float,
) -> ReferenceAtRest:
    """Compare the spots of a pendulum at rest and of its reference (n,), NaN without a spot.

    Raises DataError for too few frames with both.
    """
    common = common_motion(times_ns, reference_px, u_reference_px)
    use = common.known & np.isfinite(spot_px) & np.isfinite(u_spot_px)
    time_s = seconds(times_ns - times_ns[0])
    cleaned = (
        _without_swing(time_s[use], np.column_stack([spot_px[use], common.value[use]]), period_s)
        if np.any(use)
        else np.empty((0, 2))
    )
    spot, motion = np.full(len(use), np.nan), np.zeros(len(use))
    spot[use], motion[use] = cleaned.T
    if not common.share > 0:
        return ReferenceAtRest(float(np.nanstd(spot)), Estimate(1.0, 0.0), Estimate(np.nan, np.inf), 0.0)
    fitted = fitted_gain(spot, u_spot_px, replace(common, value=motion), use)
    corrected = spot[use] - (fitted.value if gain is None else gain) * motion[use]
    blocks = np.array_split(np.column_stack([spot[use], corrected]) ** 2, BLOCKS)
    powers = np.array([block.mean(axis=0) for block in blocks])
    factor = Estimate(_power_ratio(powers), u_of_blocks(lambda rows: _power_ratio(powers[rows]), BLOCKS))
    return ReferenceAtRest(float(np.std(spot[use])), factor, fitted, common.share)


def _power_ratio(powers: Floats) -> float:
    before, after = powers.mean(axis=0)
    return float(np.sqrt(before / after))


def _without_swing(time_s: Floats, values: Floats, period_s: float) -> Floats:
    """Values (n, series) minus their means and an oscillation at the period whose amplitude wanders."""
    knots = np.arange(0.0, time_s[-1] + _KNOT_PERIODS * period_s, _KNOT_PERIODS * period_s)
    hats = np.maximum(1 - np.abs(time_s[:, None] - knots) / (_KNOT_PERIODS * period_s), 0.0)
    phase = 2 * np.pi * time_s[:, None] / period_s
    columns = np.column_stack([np.ones_like(time_s), hats * np.cos(phase), hats * np.sin(phase)])
    return FactoredJacobian(columns).residual(values)
