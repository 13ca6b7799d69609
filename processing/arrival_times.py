"""Times at which samples were taken, from those at which they arrived."""

from itertools import pairwise

import numpy as np

from processing.arrays import Floats, Ints

_PAUSE_S, _PAUSE_STEPS = 0.5, 4.0
"""Longest pause between arrivals that is no gap, in s and in median steps: a gap is longer than both."""
_MIN_LINE_SAMPLES = 20
"""Fewest samples of a stretch to whose arrivals a line is fitted."""
_STEP_S = 0.3
"""Lasting change of lateness, in s, above which a clock was set."""
_FAR, _MOST_LOOKS = 2000, 100
"""Samples on either side over which a change has to last, and most places that are examined."""
_RUN, _FALLS = 200, 0.2
"""Samples compared after a step, and least fall of lateness, over the time, while a backlog is read."""
_WAITED, _MOST_TURNS = 5.0, 30
"""Lateness of a line that had waited, in distances of the earliest from the usual arrivals, and most fits."""


def sample_times(arrived_ns: Ints, own_s: Floats) -> tuple[Ints, tuple[float, ...]]:
    """Times at which samples were taken, from those of their arrival: in bursts, late by parts of a second.

    They are those of a line through the arrivals over the instrument's own time or, without one, over the
    count of samples, with a line of its own for each stretch without a pause. A constant lateness is found by
    the fit, as a delay.
    """
    since_s = (arrived_ns - arrived_ns[0]) * 1e-9
    steps_s: dict[int, float] = {}
    if np.all(np.isfinite(own_s)) and np.all(np.diff(own_s) > 0):
        over, begins = own_s - own_s[0], [0, len(since_s)]
        steps_s = _clock_steps(since_s - over, over)
        for place, step_s in steps_s.items():
            # a clock counts as right after it was set
            since_s[:place] += step_s
    else:
        over = np.arange(len(since_s), dtype=np.float64)
        steps = np.diff(since_s)
        paused = np.flatnonzero(steps > max(_PAUSE_S, _PAUSE_STEPS * float(np.median(steps)))) + 1
        begins = [0, *paused.tolist(), len(since_s)]
    taken_s = since_s.copy()
    for begin, end in pairwise(begins):
        if end - begin >= _MIN_LINE_SAMPLES:
            part = slice(begin, end)
            taken_s[part] = _arrival_line(over[part], since_s[part])
    times_ns = np.asarray(arrived_ns[0] + np.rint(1e9 * taken_s).astype(np.int64))
    return times_ns, tuple(steps_s.values())


def _arrival_line(over: Floats, since_s: Floats) -> Floats:
    """The line through arrivals without late ones, which may have waited for minutes; none arrives early.

    It is that of all arrivals where none is later than their usual scatter.
    """
    line = np.polyval(np.polyfit(over, since_s, 1), over)
    kept = np.ones(len(over), dtype=np.bool_)
    for _ in range(_MOST_TURNS):
        late_s = since_s - line
        low, usual = np.quantile(late_s, (0.05, 0.25))
        now = late_s <= usual + max(_STEP_S, _WAITED * (usual - low))
        if np.count_nonzero(now) < _MIN_LINE_SAMPLES or np.array_equal(now, kept):
            break
        kept = now
        line = np.polyval(np.polyfit(over[kept], since_s[kept], 1), over)
    return np.asarray(line)


def _clock_steps(late_s: Floats, own_s: Floats) -> dict[int, float]:
    """Steps (s) of lateness (n,), by the number of the first sample after each.

    A step lasts. Lateness that falls back, as of lines that waited for a thread, is no step, however long it
    takes: a backlog arrives faster than it was taken.
    """
    late_s, found = late_s.copy(), dict[int, float]()
    if len(late_s) < 2 * _MIN_LINE_SAMPLES:
        return found
    medians = np.median(np.lib.stride_tricks.sliding_window_view(late_s, _MIN_LINE_SAMPLES), axis=1)
    rise = np.abs(medians[_MIN_LINE_SAMPLES:] - medians[:-_MIN_LINE_SAMPLES])
    for _ in range(_MOST_LOOKS):
        peak = int(np.argmax(rise))
        if not rise[peak] > _STEP_S:
            break
        # the windows meet at the sample after the first one's end
        low, high = max(1, peak + 1), min(len(late_s), peak + 2 * _MIN_LINE_SAMPLES)
        place = low + int(np.argmax(np.abs(np.diff(late_s[low - 1 : high]))))
        rise[max(0, place - 2 * _MIN_LINE_SAMPLES) : place + 1] = 0.0
        if not _MIN_LINE_SAMPLES <= place <= len(late_s) - _MIN_LINE_SAMPLES:
            continue
        near, far = (
            float(np.median(late_s[place : place + reach]) - np.median(late_s[max(0, place - reach) : place]))
            for reach in (_MIN_LINE_SAMPLES, _FAR)
        )
        if (
            abs(near) > _STEP_S
            and abs(far - near) < 0.5 * abs(near)
            and not (near > 0 and _falls(late_s[place:], own_s[place:]))
        ):
            late_s[:place] += near
            found[place] = near
    return dict(sorted(found.items()))


def _falls(late_s: Floats, own_s: Floats) -> bool:
    """Whether lateness falls, from its first sample on, by more than `_FALLS` of the time."""
    reach = min(_RUN, len(late_s) // 2)
    first, later = slice(0, reach), slice(reach, 2 * reach)
    fell = float(np.median(late_s[first]) - np.median(late_s[later]))
    return fell > _FALLS * float(np.median(own_s[later]) - np.median(own_s[first]))
