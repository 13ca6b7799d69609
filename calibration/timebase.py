"""Relation of the camera's clock to the host's monotonic clock, and jitter of the frame times.

Frames have two timestamps, by the camera at exposure and by the host at arrival. A straight line through the
pairs relates the clocks. The scatter about it comes from bus and scheduler and not from the exposure. The
analysis of swings requires a jitter of the frame times below about 15 us.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.noise_models import robust_scatter
from processing.slope_uncertainty import FEWEST_PARTS, part_means, u_wandering_slope
from processing.units import S_PER_NS, nanoseconds, seconds

FRAME_JITTER_LIMIT_S = 15e-6
"""Jitter of the frame times that does not affect the times of turning points; 100 us doubles their error."""
_MIN_FRAMES = 50
_HUBER_STD = 1.345
"""Residuals larger than this many standard deviations get less weight (95 % efficiency for normal ones)."""
_ROUNDING_S = S_PER_NS / 12**0.5
"""Standard uncertainty of timestamps that are rounded to 1 ns."""
_JUMP_WINDOW = 25
"""Number of frames on each side whose medians are compared."""
_LEAST_STEP_SIGMA, _LEAST_STEP_S = 4.0, 0.5e-6
"""Smallest step of the fit, in standard deviations of arrival times and of the step, and in s."""


@dataclass(frozen=True, slots=True)
class ClockJump:
    """A step of host time minus camera time, from frame number `frame` on.

    Either one of the clocks was set, or the transfer of frames was delayed.
    """

    frame: int
    step_s: float


@dataclass(frozen=True, slots=True)
class ClockRelation:
    """Linear relation ``host = host_reference_ns + rate (device - device_reference_ns)``.

    `rate` is in seconds of the host per second of the camera. The offset includes the mean delay from
    exposure to arrival, which timestamps cannot reveal. `jitter_s` is the robust standard deviation of the
    arrival times about the line. `frame_period_s` and `frame_jitter_s` are the mean interval of the camera's
    own timestamps and their scatter about evenly spaced frames. `u_` marks standard uncertainties.
    """

    device_reference_ns: int
    host_reference_ns: int
    rate: float
    u_rate: float
    u_offset_s: float
    jitter_s: float
    frame_period_s: float
    frame_jitter_s: float
    jumps: tuple[ClockJump, ...]
    frames: int

    @property
    def drift_ppm(self) -> float:
        """Rate of the camera's clock over the host's, minus 1, in ppm; positive if the camera's runs fast."""
        return (1.0 / self.rate - 1.0) * 1e6

    @property
    def u_drift_ppm(self) -> float:
        """Standard uncertainty of `drift_ppm`."""
        return self.u_rate * 1e6

    def host_ns(self, device_ns: Ints) -> Ints:
        """Host times of camera times, (n,) integer ns."""
        since = device_ns - self.device_reference_ns
        return self.host_reference_ns + since + np.round(since * (self.rate - 1.0)).astype(np.int64)


def unwrap_counter(ticks: Ints, bits: int) -> Ints:
    """Readings (n,) of a `bits` wide counter without its overflows, each of which adds 2**bits.

    Successive readings must be less than half the counter's range apart. Raises DataError if the counter
    runs backwards.
    """
    if len(ticks) == 0:
        return ticks.astype(np.int64)
    # unsigned differences are correct also where a counter of 64 bits overflows
    unsigned = ticks.astype(np.uint64)
    steps = (unsigned[1:] - unsigned[:-1]) & np.uint64((1 << bits) - 1)
    backwards = steps > np.uint64(1 << (bits - 1))
    if backwards.any():
        frame = int(np.argmax(backwards))
        raise DataError(
            f"camera clock: runs backwards after frame {frame} ({ticks[frame]} then {ticks[frame + 1]} ticks "
            f"of a {bits}-bit counter); restart the camera"
        )
    return np.concatenate([ticks[:1].astype(np.int64), ticks[0] + np.cumsum(steps.astype(np.int64))])


def relate_clocks(device_ns: Ints, host_ns: Ints, sequence: Ints) -> ClockRelation:
    """Fit a robust straight line through pairs of timestamps.

    Parameters
    ----------
    device_ns, host_ns, sequence : (n,) int64
        Timestamps of camera and host in ns and frame numbers, in order.

    Raises
    ------
    DataError
        Fewer than 50 frames, arrays of different lengths, or a clock that does not advance.

    Notes
    -----
    Huber's M-estimate (P. J. Huber, Robust Statistics, 1981) with its asymptotic (sandwich) covariance,
    because some frames arrive much later than the others. If a clock jumps, the segments share one rate and
    have one offset each. Arrivals that vary slowly (a loaded host delays many frames in a row, its clock
    wanders or is slewed) leave the rate more uncertain than white noise of the same size: see
    `processing.slope_uncertainty`.
    """
    if not (len(device_ns) == len(host_ns) == len(sequence)):
        raise DataError(
            f"clock: {len(device_ns)} camera timestamps, {len(host_ns)} host timestamps and {len(sequence)} "
            "frame numbers must be of one length"
        )
    if len(device_ns) < _MIN_FRAMES:
        raise DataError(f"clock: {len(device_ns)} frames, {_MIN_FRAMES} are needed; record for longer")
    for name, stamps in (("camera", device_ns), ("host", host_ns)):
        backwards = np.nonzero(np.diff(stamps) <= 0)[0]
        if len(backwards):
            raise DataError(
                f"clock: the {name}'s clock does not advance after frame {sequence[backwards[0]]} "
                f"({stamps[backwards[0]]} ns, then {stamps[backwards[0] + 1]} ns); record again, or state "
                "the width of the camera's counter if it overflows (--counter-bits)"
            )
    # the clocks differ by some ppm, so a fit of their difference avoids rounding errors
    since_s = seconds(device_ns - device_ns[0])
    ahead_s = seconds((host_ns - host_ns[0]) - (device_ns - device_ns[0]))
    interval_s = np.diff(since_s)
    gaps = np.flatnonzero(interval_s > _JUMP_WINDOW * np.median(interval_s)) + 1
    breaks = sorted({*_jumps(since_s, ahead_s), *gaps.tolist()})
    values, covariance, sigma = _segments(since_s, ahead_s, breaks)
    # across a gap the rate that medians saw makes or hides a step, which the fitted rate does not
    offsets_u2 = covariance[1:, 1:]
    u_steps = np.sqrt(np.diag(offsets_u2)[1:] + np.diag(offsets_u2)[:-1] - 2 * np.diag(offsets_u2, 1))
    least = np.maximum(_LEAST_STEP_SIGMA * np.maximum(u_steps, sigma), _LEAST_STEP_S)
    small = np.abs(np.diff(values[1:])) < least
    if np.any(small):
        breaks = [frame for frame, is_small in zip(breaks, small, strict=True) if not is_small]
        values, covariance, sigma = _segments(since_s, ahead_s, breaks)
    offsets = values[1:]
    period_s, frame_jitter_s = _frame_period(since_s, sequence)
    return ClockRelation(
        device_reference_ns=int(device_ns[0]),
        host_reference_ns=int(host_ns[0]) + nanoseconds(float(offsets[0])),
        rate=1.0 + float(values[0]),
        u_rate=float(np.sqrt(covariance[0, 0])),
        u_offset_s=float(np.sqrt(covariance[1, 1])),
        jitter_s=sigma,
        frame_period_s=period_s,
        frame_jitter_s=frame_jitter_s,
        jumps=tuple(
            ClockJump(int(sequence[frame]), float(step))
            for frame, step in zip(breaks, np.diff(offsets), strict=True)
        ),
        frames=len(device_ns),
    )


def _segments(since_s: Floats, ahead_s: Floats, breaks: list[int]) -> tuple[Floats, Floats, float]:
    """The fit of one rate, and of an offset for each segment between breaks: see `_huber`."""
    segment = np.searchsorted(breaks, np.arange(len(since_s)), side="right")
    return _huber(
        np.column_stack([since_s, *(segment == k for k in range(len(breaks) + 1))]).astype(float), ahead_s
    )


def _jumps(since_s: Floats, ahead_s: Floats) -> list[int]:
    """Indices of frames at which host minus camera time steps permanently.

    Medians over windows before and after are compared, so that a single late frame is not taken for a step.
    """
    window = _JUMP_WINDOW
    if len(ahead_s) < 4 * window:
        return []
    rate = np.median(np.diff(ahead_s) / np.diff(since_s))
    flat = ahead_s - rate * since_s
    views = np.median(np.lib.stride_tricks.sliding_window_view(flat, window), axis=1)
    step = views[window:] - views[:-window]
    noise = robust_scatter(np.diff(flat)) / np.sqrt(2.0)
    limit = max(8.0 * noise, 8.0 * robust_scatter(step), 2 * _LEAST_STEP_S)
    found: list[int] = []
    candidates = np.nonzero(np.abs(step) > limit)[0]
    while len(candidates):
        top = candidates[np.argmax(np.abs(step[candidates]))]
        # the medians show the step over a whole window, in which its frame has the largest single difference
        window_of_step = slice(max(int(top), 0), int(top) + 2 * window - 1)
        frame = window_of_step.start + int(np.argmax(np.abs(np.diff(flat)[window_of_step]))) + 1
        found.append(frame)
        candidates = candidates[np.abs(candidates - top) > 2 * window]
    return sorted(found)


def _huber(design: Floats, values: Floats) -> tuple[Floats, Floats, float]:
    """Solution, covariance and robust standard deviation of the residuals, by reweighted least squares."""
    solution = np.linalg.lstsq(design, values, rcond=None)[0]
    sigma = robust_scatter(values - design @ solution)
    for _ in range(60):
        residual = values - design @ solution
        sigma = max(robust_scatter(residual), 1e-12)
        weight = np.minimum(1.0, _HUBER_STD * sigma / np.maximum(np.abs(residual), 1e-300))
        root = np.sqrt(weight)[:, None]
        new = np.linalg.lstsq(design * root, values * root[:, 0], rcond=None)[0]
        if np.allclose(new, solution, rtol=1e-13, atol=1e-16):
            solution = new
            break
        solution = new
    residual = (values - design @ solution) / sigma
    psi = np.clip(residual, -_HUBER_STD, _HUBER_STD)
    inside = np.mean(np.abs(residual) < _HUBER_STD)
    dof = len(values) - design.shape[1]
    # timestamps are integer ns: the uncertainty is not smaller than their rounding allows
    scale = max(sigma**2 * float(psi @ psi) / dof / inside**2, _ROUNDING_S**2)
    covariance = scale * np.linalg.inv(design.T @ design)
    means = part_means(design)
    if len(means) >= design.shape[1] + FEWEST_PARTS:
        # wandering affects all coefficients: that of the slope is estimated, and enlarges all alike
        u_slope = u_wandering_slope(means, part_means(sigma / inside * psi))
        covariance = covariance * max(1.0, u_slope**2 / covariance[0, 0])
    return solution.astype(np.float64), covariance.astype(np.float64), sigma


def _frame_period(since_s: Floats, sequence: Ints) -> tuple[float, float]:
    """Mean interval of frames and the jitter about it, in s."""
    design = np.column_stack([sequence - sequence[0], np.ones(len(sequence))]).astype(float)
    values, _, sigma = _huber(design, since_s)
    return float(values[0]), sigma


_MIN_PROBABILITY = 0.01
"""Probability of a chi-square below which its size is not attributed to chance."""


def birge_ratio(chi_square: float, dof: int) -> float:
    """Factor for the standard uncertainties of a weighted fit, at least 1.

    It is ``sqrt(chi_square / dof)`` (R. T. Birge, Phys. Rev. 40, 207, 1932) if a chi-square this large has a
    probability below 1 %, otherwise 1: a scatter that is small by chance must not reduce the uncertainties.
    """
    from scipy.special import chdtrc

    return math.sqrt(chi_square / dof) if dof > 0 and chdtrc(dof, chi_square) < _MIN_PROBABILITY else 1.0
