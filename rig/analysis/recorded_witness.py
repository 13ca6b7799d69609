"""The witness of the ground that a record holds itself, beside its frames."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import WITNESS
from processing.arrays import Floats, Ints
from rig.analysis.witness_file import WitnessRecord
from rig.settings import Configuration

_VALUES = ("first", "second", "third")
_FEWEST = 3
_PAUSE_S, _PAUSE_STEPS = 0.5, 4.0
"""A pause between arrivals that is longer than both, the second in steps, is a gap."""
_LINE = 20
"""Fewest samples of a stretch whose arrivals make a line."""
_STEP_S = 0.3
"""Lateness that rises or falls by more at once, and stays so, is a clock that was set."""
_FAR, _MOST_LOOKS = 2000, 100
CLOCK_SET = "clock set while it was recorded,"


def recorded_witness(reader: RecordReader, config: Configuration) -> WitnessRecord | None:
    """Its samples on the frames' clock; None without any, or with witness.kind = 'none'."""
    if config.witness.kind == "none":
        return None
    table = reader.table(WITNESS.topic)
    if len(table) < _FEWEST:
        return None
    names = config.witness.components
    times_ns, steps_s = taken(table["time_ns"], table["own_time_s"])
    order = np.concatenate([[True], np.diff(times_ns) > 0])
    stray = int(np.count_nonzero(~order))
    value = np.column_stack([table[name] for name in _VALUES[: len(names)]])
    return WitnessRecord(
        f"{reader.path.name}: {WITNESS.topic}",
        times_ns[order] - times_ns[0],
        value[order],
        names,
        int(times_ns[0]),
        absolute=False,
        # which of two clocks was right, or neither, nobody knows
        offset_stated=not steps_s,
        understood=(
            f"columns: {', '.join(names)}",
            *(f"{CLOCK_SET} by {step:+.4g} s; times before it follow those after it" for step in steps_s),
            *([f"left out: {stray} samples that are not later than the one before"] if stray else []),
        ),
    )


class Taken(NamedTuple):
    """When samples were taken, on the frames' clock, and by what one of the clocks was set meanwhile."""

    times_ns: Ints
    steps_s: tuple[float, ...]


def taken(arrived_ns: Ints, own_s: Floats) -> Taken:
    """When samples were taken: lines arrive in bursts, late by parts of a second.

    By a line through the arrivals over the instrument's own time; without one, over the count of samples, for
    each stretch without a pause of its own. What is constant of the lateness the fit finds as a delay.
    """
    since_s = (arrived_ns - arrived_ns[0]) * 1e-9
    steps_s: dict[int, float] = {}
    if np.all(np.isfinite(own_s)) and np.all(np.diff(own_s) > 0):
        over, begins = own_s - own_s[0], [0, len(since_s)]
        steps_s = _steps_of(since_s - over)
        for place, step_s in steps_s.items():
            # a clock that was set is right from then on
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
            taken_s[part] = np.polyval(np.polyfit(over[part], since_s[part], 1), over[part])
    times_ns = np.asarray(arrived_ns[0] + np.rint(1e9 * taken_s).astype(np.int64))
    return Taken(times_ns, tuple(steps_s.values()))


def _steps_of(late_s: Floats) -> dict[int, float]:
    """Steps (s) of lateness (n,) by the sample that they come with.

    A step stays: lateness that falls back, as of lines that waited for a thread, is none.
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
        if abs(near) > _STEP_S and abs(far - near) < 0.5 * abs(near):
            late_s[:place] += near
            found[place] = near
    return dict(sorted(found.items()))
