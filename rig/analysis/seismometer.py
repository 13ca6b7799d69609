"""The auxiliary seismometer in a record, the times of its samples, and sentences on its use."""

from itertools import pairwise
from math import isfinite, pi
from typing import NamedTuple

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import WITNESS
from processing.arrays import Floats, Ints
from processing.fit import Response, SeismometerUse
from rig.analysis.seismometer_file import SeismometerRecord
from rig.presentation import percent, plain, quantity, with_uncertainty
from rig.settings import Configuration

_VALUES = ("first", "second", "third")
_FEWEST = 3
_PAUSE_S, _PAUSE_STEPS = 0.5, 4.0
"""Longest pause between arrivals that is no gap, in s and in median steps: a gap is longer than both."""
_LINE = 20
"""Fewest samples of a stretch to whose arrivals a line is fitted."""
_STEP_S = 0.3
"""Lasting change of lateness, in s, above which a clock was set."""
_FAR, _MOST_LOOKS = 2000, 100
"""Samples on either side over which a change has to last, and most places that are examined."""
_RUN, _FALLS = 200, 0.2
"""Samples compared after a step, and least fall of lateness, over the time, while a backlog is read."""
_WAITED, _MOST_TURNS = 5.0, 30
"""Lateness of a line that had waited, in distances of the earliest from the usual arrivals, and most fits."""
CLOCK_SET = "clock set while it was recorded,"


def recorded_witness(reader: RecordReader, config: Configuration) -> SeismometerRecord | None:
    """A record's seismometer samples on the frames' clock; None without any, or for witness.kind = 'none'."""
    if config.witness.kind == "none":
        return None
    table = reader.table(WITNESS.topic)
    if len(table) < _FEWEST:
        return None
    names = config.witness.components
    times_ns, steps_s = sample_times(table["time_ns"], table["own_time_s"])
    order = np.concatenate([[True], np.diff(times_ns) > 0])
    stray = int(np.count_nonzero(~order))
    value = np.column_stack([table[name] for name in _VALUES[: len(names)]])
    return SeismometerRecord(
        f"{reader.path.name}: {WITNESS.topic}",
        times_ns[order] - times_ns[0],
        value[order],
        names,
        int(times_ns[0]),
        absolute=False,
        # after a step it is not known which of the two clocks was right
        offset_stated=not steps_s,
        understood=(
            f"columns: {', '.join(names)}",
            *(f"{CLOCK_SET} by {step:+.4g} s; times before it follow those after it" for step in steps_s),
            *([f"left out: {stray} samples not later than the previous one"] if stray else []),
        ),
    )


class SampleTimes(NamedTuple):
    """Times of samples on the frames' clock, and the steps in s by which one of the clocks was set."""

    times_ns: Ints
    steps_s: tuple[float, ...]


def sample_times(arrived_ns: Ints, own_s: Floats) -> SampleTimes:
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
        if end - begin >= _LINE:
            part = slice(begin, end)
            taken_s[part] = _arrival_line(over[part], since_s[part])
    times_ns = np.asarray(arrived_ns[0] + np.rint(1e9 * taken_s).astype(np.int64))
    return SampleTimes(times_ns, tuple(steps_s.values()))


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
        if np.count_nonzero(now) < _LINE or np.array_equal(now, kept):
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
    if len(late_s) < 2 * _LINE:
        return found
    medians = np.median(np.lib.stride_tricks.sliding_window_view(late_s, _LINE), axis=1)
    rise = np.abs(medians[_LINE:] - medians[:-_LINE])
    for _ in range(_MOST_LOOKS):
        peak = int(np.argmax(rise))
        if not rise[peak] > _STEP_S:
            break
        # the windows meet at the sample after the first one's end
        low, high = max(1, peak + 1), min(len(late_s), peak + 2 * _LINE)
        place = low + int(np.argmax(np.abs(np.diff(late_s[low - 1 : high]))))
        rise[max(0, place - 2 * _LINE) : place + 1] = 0.0
        if not _LINE <= place <= len(late_s) - _LINE:
            continue
        near, far = (
            float(np.median(late_s[place : place + reach]) - np.median(late_s[max(0, place - reach) : place]))
            for reach in (_LINE, _FAR)
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


_NAMED_FACTOR = 1.05
"""Factor by which an uncertainty is smaller, above which it is named."""


def witness_sentences(use: SeismometerUse) -> list[str]:
    """Sentences on the use of a seismometer, or its refusal, and on samples that were left out."""
    lost = [line for line in use.understood if line.startswith(("left out", "missing", CLOCK_SET))]
    return [*_use_sentences(use), *([f"Of the seismometer {use.source}: {'; '.join(lost)}."] if lost else [])]


def _use_sentences(use: SeismometerUse) -> list[str]:
    if not use.used:
        gain = use.gain_of_prediction
        judged = f" (gain of prediction {gain:+.3g})" if isfinite(gain) else ""
        reason = f": {use.reason}" if use.reason else ""
        sought = f"; {use.offsets_tried} offsets of its clock were tried" if use.offsets_tried else ""
        verdict_text = f"Auxiliary seismometer {use.verdict}{reason}{judged}{sought}."
        return [f"{verdict_text} The results are the same as without it."]
    before, left = use.ground_alone_rad_per_s2_rthz, use.ground_left_rad_per_s2_rthz
    explained = (
        f"it explains {percent(use.explained, 4)} of the drive at the pendulum's frequency, which falls from "
        f"{with_uncertainty(*before)} to {with_uncertainty(*left)} rad/s²/√Hz"
    )
    if use.spectra is not None and isfinite(use.spectra.coherence_near):
        explained += (
            f" (squared coherence within a tenth of it {use.spectra.coherence_near:.4g}, over "
            f"{use.spectra.stretches} stretches)"
        )
    responses = "; ".join(map(_response_text, use.responses))
    lines = [f"Auxiliary seismometer: {explained}. Its response: {responses}."]
    saved = ", ".join(
        f"{plain(factor, 3)} ({quantity(name).symbol})"
        for name, factor in use.saved.items()
        if factor > _NAMED_FACTOR
    )
    if saved:
        lines.append(f"The seismometer reduces the uncertainties by factors of {saved}.")
    found = f"{use.offset_s:+.5g} s, the best of {use.offsets_tried}, and " if use.offsets_tried else ""
    lines.append(
        f"Clock of the seismometer: {found}{with_uncertainty(*use.delay_s)} s to be added to its times, "
        f"drift {with_uncertainty(*use.clock_drift)} s/s."
    )
    if use.missing_half_cycles:
        lines.append(
            f"{use.missing_half_cycles} half-swings have no witness; their drive is treated as unknown."
        )
    return lines


def _response_text(response: Response) -> str:
    degrees = 180 / pi
    slope = ", changing within the band" if response.with_slope else ""
    return (
        f"{response.name} {with_uncertainty(response.gain, response.u_gain)} rad/s² per unit at "
        f"{with_uncertainty(degrees * response.phase_rad, degrees * response.u_phase_rad)}°{slope}"
    )
