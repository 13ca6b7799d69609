"""Relation of the camera's clock to the host's monotonic clock, and jitter of the frame times.

Frames have two timestamps, by the camera at exposure and by the host at arrival. A straight line through the
pairs relates the clocks. The scatter about it comes from bus and scheduler and not from the exposure.
"""

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
_MIN_STEP_SIGMA = 4.0
"""Smallest step that is kept, over the larger of the jitter and the step's standard uncertainty."""
_MIN_STEP_S = 0.5e-6
"""Smallest step in s that is kept."""


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

    The device is the camera. The offset includes the mean delay from exposure to arrival, which timestamps
    cannot reveal. `u_` marks standard uncertainties.
    """

    device_reference_ns: int
    host_reference_ns: int
    rate: float
    """Seconds of the host per second of the camera."""
    u_rate: float
    u_offset_s: float
    jitter_s: float
    """Robust standard deviation of the arrival times about the line."""
    frame_period_s: float
    """Mean interval of the camera's timestamps."""
    frame_jitter_s: float
    """Scatter of the camera's timestamps about evenly spaced frames."""
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
        Fewer frames than `_MIN_FRAMES`, or a clock that does not advance.

    Notes
    -----
    Huber's M-estimate (P. J. Huber, Robust Statistics, 1981) with its asymptotic (sandwich) covariance,
    because some frames arrive much later than the others. If a clock jumps, the segments share one rate and
    have one offset each. Arrivals that vary slowly (a loaded host delays many frames in a row, its clock
    wanders or is slewed) leave the rate more uncertain than white noise of the same size: see
    `processing.slope_uncertainty`.
    """
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
    host_ahead_s = seconds((host_ns - host_ns[0]) - (device_ns - device_ns[0]))
    interval_s = np.diff(since_s)
    gaps = np.flatnonzero(interval_s > _JUMP_WINDOW * np.median(interval_s)) + 1
    breaks = sorted({*_jumps(since_s, host_ahead_s), *gaps.tolist()})
    values, covariance, sigma = _segments(since_s, host_ahead_s, breaks)
    # `_jumps` removes a rate from medians; over a long gap its error looks like a step or hides one. The
    # fitted rate is better: each gap is a break, and each step is tested with it
    u2_offsets = covariance[1:, 1:]
    u_steps = np.sqrt(np.diag(u2_offsets)[1:] + np.diag(u2_offsets)[:-1] - 2 * np.diag(u2_offsets, 1))
    min_steps_s = np.maximum(_MIN_STEP_SIGMA * np.maximum(u_steps, sigma), _MIN_STEP_S)
    is_small = np.abs(np.diff(values[1:])) < min_steps_s
    if np.any(is_small):
        breaks = np.array(breaks)[~is_small].tolist()
        values, covariance, sigma = _segments(since_s, host_ahead_s, breaks)
    offsets = values[1:]
    counted = np.column_stack([sequence - sequence[0], np.ones(len(sequence))]).astype(float)
    (period_s, _), _, frame_jitter_s = _huber(counted, since_s)
    return ClockRelation(
        device_reference_ns=int(device_ns[0]),
        host_reference_ns=int(host_ns[0]) + nanoseconds(float(offsets[0])),
        rate=1.0 + float(values[0]),
        u_rate=float(np.sqrt(covariance[0, 0])),
        u_offset_s=float(np.sqrt(covariance[1, 1])),
        jitter_s=sigma,
        frame_period_s=float(period_s),
        frame_jitter_s=frame_jitter_s,
        jumps=tuple(
            ClockJump(int(sequence[frame]), float(step))
            for frame, step in zip(breaks, np.diff(offsets), strict=True)
        ),
        frames=len(device_ns),
    )


def _segments(since_s: Floats, host_ahead_s: Floats, breaks: list[int]) -> tuple[Floats, Floats, float]:
    """The fit of one rate, and of an offset for each segment between breaks: see `_huber`."""
    segment = np.searchsorted(breaks, np.arange(len(since_s)), side="right")
    is_in_segment = (segment == k for k in range(len(breaks) + 1))
    return _huber(np.column_stack([since_s, *is_in_segment]).astype(float), host_ahead_s)


def _jumps(since_s: Floats, host_ahead_s: Floats) -> list[int]:
    """Frames at which host minus camera time steps permanently, by medians over windows before and after."""
    window = _JUMP_WINDOW
    if len(host_ahead_s) < 4 * window:
        return []
    rate = np.median(np.diff(host_ahead_s) / np.diff(since_s))
    flat = host_ahead_s - rate * since_s
    medians = np.median(np.lib.stride_tricks.sliding_window_view(flat, window), axis=1)
    step = medians[window:] - medians[:-window]
    noise = robust_scatter(np.diff(flat)) / np.sqrt(2.0)
    limit = max(8.0 * noise, 8.0 * robust_scatter(step), 2 * _MIN_STEP_S)
    jumps: list[int] = []
    candidates = np.nonzero(np.abs(step) > limit)[0]
    while len(candidates):
        top = int(candidates[np.argmax(np.abs(step[candidates]))])
        # the medians show the step over a whole window, in which its frame has the largest single difference
        differences = np.abs(np.diff(flat[top : top + 2 * window]))
        jumps.append(top + int(np.argmax(differences)) + 1)
        candidates = candidates[np.abs(candidates - top) > 2 * window]
    return sorted(jumps)


def _huber(design: Floats, values: Floats) -> tuple[Floats, Floats, float]:
    """Solution, covariance and robust standard deviation of the residuals, by reweighted least squares."""
    solution = np.linalg.lstsq(design, values, rcond=None)[0]
    for _ in range(60):
        residual = values - design @ solution
        sigma = max(robust_scatter(residual), 1e-12)
        weight = np.minimum(1.0, _HUBER_STD * sigma / np.maximum(np.abs(residual), 1e-300))
        root = np.sqrt(weight)[:, None]
        last, solution = solution, np.linalg.lstsq(design * root, values * root[:, 0], rcond=None)[0]
        if np.allclose(solution, last, rtol=1e-13, atol=1e-16):
            break
    residual = (values - design @ solution) / sigma
    psi = np.clip(residual, -_HUBER_STD, _HUBER_STD)
    fraction_inside = np.mean(np.abs(residual) < _HUBER_STD)
    dof = len(values) - design.shape[1]
    # timestamps are integer ns: the uncertainty is not smaller than their rounding allows
    scale = max(sigma**2 * float(psi @ psi) / dof / fraction_inside**2, _ROUNDING_S**2)
    covariance = scale * np.linalg.inv(design.T @ design)
    means = part_means(design)
    if len(means) >= design.shape[1] + FEWEST_PARTS:
        # arrivals that wander affect all coefficients; the slope shows by which factor, which is used for all
        u_slope = u_wandering_slope(means, part_means(sigma / fraction_inside * psi))
        covariance = covariance * max(1.0, u_slope**2 / covariance[0, 0])
    return solution.astype(np.float64), covariance.astype(np.float64), sigma
