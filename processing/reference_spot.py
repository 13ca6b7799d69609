"""Correction of the pendulum's spot by a reference spot from a fixed mirror."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from math import inf

import numpy as np

from processing.arrays import Flags, Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.units import seconds

_BANDS_PER_DECADE = 8
"""Bands over which the spectrum of the reference is averaged; in each the filter is constant."""
_PADDED_FRACTION = 0.5
"""Length by which a run is mirrored at each end, relative to its length."""
_END_FRAMES = 10
"""Frames averaged for the level at an end of a run."""
_MAX_GAP_S = 0.5
"""Longest gap bridged by interpolation of the motion."""
_MIN_FRAMES = 200
BLOCKS = 10
"""Blocks whose scatter is the uncertainty of an estimate."""
_MIN_FALL = 12.0
"""Smallest fall of -2 ln L of the frames at rest for which a reference is used."""


class ReferenceVerdict(StrEnum):
    """Use or refusal of a reference."""

    USED = "used"
    NO_GAIN = "refused: the pendulum's spot is not quieter for it"
    QUIET = "refused: it shows no motion above its own noise"
    UNKNOWN_GAIN = "refused: its gain is not stated, and the run does not show it"


@dataclass(frozen=True, slots=True)
class CommonMotion:
    """Motion common to both spots, from the reference spot, along one axis of the sensor, in px."""

    value: Floats
    u: Floats
    """Motion (n,) about its mean, and its standard uncertainty, from the motion that the filter removes and
    the noise that it passes; 0 and infinite in long gaps of the reference."""
    known: Flags
    """Whether the motion is known in each frame (n,)."""
    share: float
    """Part of the reference's variance that is motion."""


def common_motion(times_ns: Ints, position_px: Floats, u_px: Floats) -> CommonMotion:
    """Filter the noise out of a reference spot's positions (n,), NaN in frames without a spot.

    Raises DataError for too few frames.
    """
    has_spot = np.isfinite(position_px) & np.isfinite(u_px)
    if np.count_nonzero(has_spot) < _MIN_FRAMES:
        raise DataError(
            f"the reference spot is found in {np.count_nonzero(has_spot)} frames; {_MIN_FRAMES} are needed"
        )
    time_s = seconds(times_ns - times_ns[0])
    step_s = float(np.median(np.diff(time_s)))
    even_s = step_s * np.arange(round(time_s[-1] / step_s) + 1)
    even = np.interp(even_s, time_s[has_spot], position_px[has_spot])
    even -= even.mean()
    noise = float(np.mean(u_px[has_spot] ** 2))
    pad = max(1, min(int(_PADDED_FRACTION * len(even)), len(even) - 1))
    # mirrored about the mean level at each end; mirroring about one noisy frame would make a step
    first, last = float(even[:_END_FRAMES].mean()), float(even[-_END_FRAMES:].mean())
    padded = np.concatenate([2 * first - even[pad:0:-1], even, 2 * last - even[-2 : -2 - pad : -1]])
    spectrum = np.fft.rfft(padded)
    # the contribution of each frequency to the variance of a sample
    power = 2 * np.abs(spectrum) ** 2 / len(padded) ** 2
    white = 2 * noise / len(padded)
    motion = np.maximum(_in_bands(power) - white, 0.0)
    transfer = motion / np.maximum(motion + white, np.finfo(float).tiny)
    filtered = np.fft.irfft(transfer * spectrum, len(padded))[pad : pad + len(even)]
    u = float(np.sqrt(np.sum(transfer[1:] * white)))
    known = ~_is_in_gap(time_s, time_s[has_spot])
    value = np.where(known, np.interp(time_s, even_s, filtered), 0.0)
    variance = float(np.sum(motion[1:]))
    return CommonMotion(value, np.where(known, u, inf), known, variance / (variance + noise))


def _in_bands(power: Floats) -> Floats:
    """Means over bands of equal width in log frequency, each band at least one frequency wide."""
    band = np.zeros(len(power))
    band[1:] = np.floor(np.log10(np.arange(1, len(power))) * _BANDS_PER_DECADE) + 1
    _, first, band_of = np.unique(band, return_index=True, return_inverse=True)
    counts = np.diff([*first, len(power)])
    return np.asarray((np.add.reduceat(power, first) / counts)[band_of])


def _is_in_gap(time_s: Floats, spot_s: Floats) -> Flags:
    """Whether each time (n,) is in a gap of the times `spot_s` that is longer than `_MAX_GAP_S`."""
    following = np.clip(np.searchsorted(spot_s, time_s), 0, len(spot_s) - 1)
    preceding = np.clip(following - 1, 0, len(spot_s) - 1)
    gap_s = np.where(
        time_s < spot_s[0],
        spot_s[0] - time_s,
        np.where(time_s > spot_s[-1], time_s - spot_s[-1], spot_s[following] - spot_s[preceding]),
    )
    return np.asarray((gap_s > _MAX_GAP_S) & (spot_s[following] != time_s))


@dataclass(frozen=True, slots=True)
class CorrectedPositions:
    """Positions of the pendulum's spot minus the common motion, along one axis, in px.

    If the reference is refused, all positions are unchanged.
    """

    position_px: Floats
    u_px: Floats
    fallen_back: Flags
    """Frames in a long gap of the reference: positions are unchanged, their u includes the common motion."""
    gain: Estimate
    verdict: ReferenceVerdict


def fitted_gain(position_px: Floats, u_px: Floats, common: CommonMotion, quiet: Flags) -> Estimate:
    """Motion of the pendulum's spot per motion of the reference, in `quiet` frames, of a pendulum at rest.

    The reference's noise is filtered out of the motion, so that it does not reduce the gain. Successive
    frames are correlated: the uncertainty follows from the scatter of blocks.

    Raises DataError for too few quiet frames.
    """
    use = quiet & common.known & np.isfinite(position_px) & np.isfinite(u_px)
    if np.count_nonzero(use) < _MIN_FRAMES:
        raise DataError(
            f"{np.count_nonzero(use)} frames at rest have both spots; {_MIN_FRAMES} are needed for the gain "
            "of the reference: state it, or let the pendulum rest for longer before it is released"
        )
    spot, motion = position_px[use], common.value[use]
    u = u_of_blocks(lambda rows: _gain(spot[rows], motion[rows]), len(spot))
    return Estimate(_gain(spot, motion), u)


def u_of_blocks(estimate: Callable[[Ints], float], count: int) -> float:
    """Standard uncertainty of an estimate of `count` neighbouring rows, by leaving out each of ten blocks."""
    rows = np.arange(count)
    without = np.array([estimate(np.delete(rows, block)) for block in np.array_split(rows, BLOCKS)])
    spread = without - without.mean()
    return float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum(spread**2)))


def _gain(position: Floats, motion: Floats) -> float:
    centred = motion - motion.mean()
    return float(centred @ position / (centred @ centred))


def uncorrected(
    position_px: Floats, u_px: Floats, gain: Estimate, verdict: ReferenceVerdict
) -> CorrectedPositions:
    """Unchanged positions, with the verdict."""
    return CorrectedPositions(position_px, u_px, np.zeros(len(position_px), dtype=np.bool_), gain, verdict)


def subtract_common_motion(
    position_px: Floats, u_px: Floats, common: CommonMotion, gain: Estimate, quiet: Flags
) -> CorrectedPositions:
    """Subtract the common motion, if that lowers -2 ln L of the frames at rest by enough.

    Parameters
    ----------
    position_px, u_px
        The pendulum's spot, NaN where it was lost.
    gain
        Motion of the pendulum's spot over that of the reference.
    quiet
        Frames in which the pendulum rests. With too few, `gain` is not tested.
    """
    if not common.share > 0:
        return uncorrected(position_px, u_px, gain, ReferenceVerdict.QUIET)
    fall = _likelihood_fall(position_px, common, gain.value, quiet)
    if fall is not None and not fall > _MIN_FALL:
        return uncorrected(position_px, u_px, gain, ReferenceVerdict.NO_GAIN)
    rms_px = float(np.sqrt(np.mean(common.value[common.known] ** 2)))
    variance = u_px**2 + (gain.value * np.where(common.known, common.u, rms_px)) ** 2
    variance += np.where(common.known, (gain.standard_uncertainty * common.value) ** 2, 0.0)
    return CorrectedPositions(
        position_px - gain.value * common.value,
        np.sqrt(variance),
        ~common.known,
        gain,
        ReferenceVerdict.USED,
    )


def _likelihood_fall(position: Floats, common: CommonMotion, gain: float, quiet: Flags) -> float | None:
    """Fall of -2 ln L of the frames at rest, by the number of independent ones; None with too few."""
    use = quiet & common.known & np.isfinite(position)
    if np.count_nonzero(use) < _MIN_FRAMES:
        return None
    before = position[use] - position[use].mean()
    after = before - gain * (common.value[use] - common.value[use].mean())
    return float(_independent_count(before) * np.log(np.mean(before**2) / np.mean(after**2)))


def _independent_count(values: Floats) -> float:
    """Effective number of independent values, by their autocorrelation up to its first zero."""
    spectrum = np.abs(np.fft.rfft(values, 2 * len(values))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(values)]
    correlation /= correlation[0]
    below = np.flatnonzero(correlation <= 0)
    length = int(below[0]) if len(below) else len(values)
    return len(values) / (1 + 2 * float(np.sum(correlation[1:length])))
