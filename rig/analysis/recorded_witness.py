"""The witness of the ground that a record holds itself, beside its frames."""

from itertools import pairwise

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


def recorded_witness(reader: RecordReader, config: Configuration) -> WitnessRecord | None:
    """Its samples on the frames' clock; None without any, or with witness.kind = 'none'."""
    if config.witness.kind == "none":
        return None
    table = reader.table(WITNESS.topic)
    if len(table) < _FEWEST:
        return None
    names = config.witness.components
    stray = int(np.count_nonzero(np.diff(table["time_ns"]) <= 0))
    times_ns = when_taken(table["time_ns"], table["own_time_s"])
    order = np.concatenate([[True], np.diff(times_ns) > 0])
    value = np.column_stack([table[name] for name in _VALUES[: len(names)]])
    return WitnessRecord(
        f"{reader.path.name}: {WITNESS.topic}",
        times_ns[order] - times_ns[0],
        value[order],
        names,
        int(times_ns[0]),
        absolute=False,
        offset_stated=True,
        understood=(
            f"columns: {', '.join(names)}",
            *([f"left out: {stray} samples that are not later than the one before"] if stray else []),
        ),
    )


def when_taken(arrived_ns: Ints, own_s: Floats) -> Ints:
    """When samples were taken, on the frames' clock: lines arrive in bursts, late by parts of a second.

    By a line through the arrivals over the instrument's own time; without one, over the count of samples, for
    each stretch without a pause of its own. What is constant of the lateness the fit finds as a delay.
    """
    since_s = (arrived_ns - arrived_ns[0]) * 1e-9
    if np.all(np.isfinite(own_s)) and np.all(np.diff(own_s) > 0):
        over, begins = own_s - own_s[0], [0, len(since_s)]
    else:
        over = np.arange(len(since_s), dtype=np.float64)
        steps = np.diff(since_s)
        paused = np.flatnonzero(steps > max(_PAUSE_S, _PAUSE_STEPS * float(np.median(steps)))) + 1
        begins = [0, *paused.tolist(), len(since_s)]
    taken = since_s.copy()
    for begin, end in pairwise(begins):
        if end - begin >= _LINE:
            part = slice(begin, end)
            taken[part] = np.polyval(np.polyfit(over[part], since_s[part], 1), over[part])
    return np.asarray(arrived_ns[0] + np.rint(1e9 * taken).astype(np.int64))
