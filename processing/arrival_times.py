"""Times at which samples were taken, from those at which they arrived."""

from itertools import pairwise

import numpy as np

from processing.arrays import Floats, Ints
from processing.units import nanoseconds, seconds

_PAUSE_S, _PAUSE_STEPS = 0.5, 4.0
"""Longest pause between arrivals that is no gap, in s and in median steps: a gap is longer than both."""
_MIN_LINE_SAMPLES = 20
"""Fewest samples of a stretch to whose arrivals a line is fitted."""
_CLOCK_STEP_S = 0.3
"""Lasting change of delay, in s, above which a clock was set."""
_LASTING_SAMPLES = 2000
"""Samples on either side over which a change has to last."""
_MAX_CANDIDATES = 100
"""Most samples that are examined for a step."""
_BACKLOG_SAMPLES = 200
"""Samples after a step over which a backlog is looked for."""
_BACKLOG_FALL = 0.2
"""Smallest fall of the delay, over the time, while a backlog is read."""
_MAX_DELAY_RATIO = 5.0
"""Largest delay of arrivals that are fitted, in distances of the earliest from the usual arrivals."""
_MAX_FITS = 30


def sample_times(arrived_ns: Ints, own_s: Floats) -> tuple[Ints, tuple[float, ...]]:
    """Times at which samples were taken, and the steps (s) of a clock that was set, from times of arrival.

    Samples arrive in bursts, late by parts of a second. The times are those of a line through the arrivals
    over the instrument's own time or, without one, over the count of samples, with a line of its own for each
    stretch without a pause. The fit of a seismometer's record determines a constant delay.
    """
    since_s = seconds(arrived_ns - arrived_ns[0])
    steps_s: dict[int, float] = {}
    if np.all(np.isfinite(own_s)) and np.all(np.diff(own_s) > 0):
        x, edges = own_s - own_s[0], [0, len(since_s)]
        steps_s = _clock_steps(since_s - x, x)
        for sample, step_s in steps_s.items():
            # a clock counts as right after it was set
            since_s[:sample] += step_s
    else:
        x = np.arange(len(since_s), dtype=np.float64)
        intervals_s = np.diff(since_s)
        max_interval_s = max(_PAUSE_S, _PAUSE_STEPS * float(np.median(intervals_s)))
        edges = [0, *(np.flatnonzero(intervals_s > max_interval_s) + 1).tolist(), len(since_s)]
    taken_s = since_s.copy()
    for begin, end in pairwise(edges):
        if end - begin >= _MIN_LINE_SAMPLES:
            taken_s[begin:end] = _arrival_line(x[begin:end], since_s[begin:end])
    return arrived_ns[0] + nanoseconds(taken_s), tuple(steps_s.values())


def _arrival_line(x: Floats, since_s: Floats) -> Floats:
    """The line through arrivals without those that waited, maybe for minutes; none arrives early."""
    line = np.polyval(np.polyfit(x, since_s, 1), x)
    is_fitted = np.ones(len(x), dtype=np.bool_)
    for _ in range(_MAX_FITS):
        delay_s = since_s - line
        earliest, usual = np.quantile(delay_s, (0.05, 0.25))
        is_usual = delay_s <= usual + max(_CLOCK_STEP_S, _MAX_DELAY_RATIO * (usual - earliest))
        if np.count_nonzero(is_usual) < _MIN_LINE_SAMPLES or np.array_equal(is_usual, is_fitted):
            break
        is_fitted = is_usual
        line = np.polyval(np.polyfit(x[is_fitted], since_s[is_fitted], 1), x)
    return np.asarray(line)


def _clock_steps(delay_s: Floats, own_s: Floats) -> dict[int, float]:
    """Steps (s) of the delay (n,), by the number of the first sample after each. A delay that falls back is
    no step, but a backlog, which arrives faster than it was taken."""
    delay_s, steps_s = delay_s.copy(), dict[int, float]()
    if len(delay_s) < 2 * _MIN_LINE_SAMPLES:
        return steps_s
    medians = np.median(np.lib.stride_tricks.sliding_window_view(delay_s, _MIN_LINE_SAMPLES), axis=1)
    change_s = np.abs(medians[_MIN_LINE_SAMPLES:] - medians[:-_MIN_LINE_SAMPLES])
    for _ in range(_MAX_CANDIDATES):
        peak = int(np.argmax(change_s))
        if not change_s[peak] > _CLOCK_STEP_S:
            break
        # the windows meet at the sample after the first one's end
        low, high = max(1, peak + 1), min(len(delay_s), peak + 2 * _MIN_LINE_SAMPLES)
        sample = low + int(np.argmax(np.abs(np.diff(delay_s[low - 1 : high]))))
        change_s[max(0, sample - 2 * _MIN_LINE_SAMPLES) : sample + 1] = 0.0
        if not _MIN_LINE_SAMPLES <= sample <= len(delay_s) - _MIN_LINE_SAMPLES:
            continue
        step_s, lasting_s = (
            float(np.median(delay_s[sample:][:count]) - np.median(delay_s[max(0, sample - count) : sample]))
            for count in (_MIN_LINE_SAMPLES, _LASTING_SAMPLES)
        )
        if (
            abs(step_s) > _CLOCK_STEP_S
            and abs(lasting_s - step_s) < 0.5 * abs(step_s)
            and not (step_s > 0 and _is_backlog(delay_s[sample:], own_s[sample:]))
        ):
            delay_s[:sample] += step_s
            steps_s[sample] = step_s
    return dict(sorted(steps_s.items()))


def _is_backlog(delay_s: Floats, own_s: Floats) -> bool:
    """Whether the delay falls, from its first sample on, by more than `_BACKLOG_FALL` of the time."""
    count = min(_BACKLOG_SAMPLES, len(delay_s) // 2)
    first, second = slice(0, count), slice(count, 2 * count)
    fall_s = float(np.median(delay_s[first]) - np.median(delay_s[second]))
    return fall_s > _BACKLOG_FALL * float(np.median(own_s[second]) - np.median(own_s[first]))
