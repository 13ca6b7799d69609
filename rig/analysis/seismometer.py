"""A seismometer or tiltmeter beside the run: from a table, miniSEED, SAC, or the record itself."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from math import isfinite, pi
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import WITNESS
from processing.arrays import Floats, Ints
from processing.errors import ConfigurationError, DataError, MissingPackage, RigError
from processing.fit import Response, SeismometerUse, Witness
from processing.units import NS_PER_S, nanoseconds, seconds
from rig.intake import read_columns
from rig.presentation import percent, plain, quantity, with_uncertainty
from rig.settings import Configuration

_SEISMIC = (".mseed", ".miniseed", ".ms", ".sac", ".seed")
FIRST_UTC_S = 1e9
"""Times of a table from which on they count from 1970: this was in 2001, and no run lasts so long."""
_SAME_TICK_NS = 1000
"""Channels that begin within this begin together."""
_REMEDIES: Final = {
    ", or the rows in a second: --rate HZ --position COLUMN": "",
    "name the time column with --time": "call the time column time_s",
    "--time-unit": "--witness-time-unit",
    "--position": "--witness-column",
}
"""Options of a table that is fitted, and what a witness has in their place."""


@dataclass(frozen=True)
class SeismometerSource:
    """Which file holds a witness, which of its columns or channels, and what is added to its times.

    `offset_s` None: the times stand as they are, and are sought where they explain nothing. `time_unit` is
    that of a table's times, where its header does not say it.
    """

    path: Path
    columns: tuple[str, ...] = ()
    offset_s: float | None = None
    time_unit: str = ""

    def read(self) -> "SeismometerRecord":
        """The file. Raises DataError or ConfigurationError in one line."""
        if self.path.suffix.lower() not in _SEISMIC:
            found = _read_table(self.path, self.columns, self.time_unit)
        elif self.time_unit:
            raise ConfigurationError(
                f"--witness-time-unit {self.time_unit}: {self.path} has times of its own; leave the "
                "option out"
            )
        else:
            found = _read_seismic(self.path, self.columns)
        if self.offset_s is None:
            return found
        return replace(found, first_ns=found.first_ns + nanoseconds(self.offset_s), offset_stated=True)


@dataclass(frozen=True, eq=False)
class SeismometerRecord:
    """Samples of a witness: times (n,) in ns from the first, values (n, components), NaN where missing.

    `understood` says in lines what its file was taken for, and which rows were left out.
    `first_ns` is the first sample's time: since 1970 where `absolute`, else on the clock of the run's file.
    """

    name: str
    times_ns: Ints
    value: Floats
    names: tuple[str, ...]
    first_ns: int
    absolute: bool
    offset_stated: bool = False
    understood: tuple[str, ...] = ()

    def beside(self, begin: "FitStart") -> tuple[Witness, bool]:
        """On the clock of turning points, and whether that is known up to a fraction of a period."""
        known = self.offset_stated
        if not self.absolute or (self.offset_stated and begin.utc_ns is None):
            zero_ns = begin.in_file_ns
        elif begin.utc_ns is not None:
            zero_ns, known = begin.utc_ns, True
        else:
            # neither's clock says anything of the other's
            zero_ns, known = self.first_ns, False
        return Witness(seconds(self.times_ns + (self.first_ns - zero_ns)), self.value, self.names), known


@dataclass(frozen=True, slots=True)
class FitStart:
    """The first turning point that is fitted: on the clock of its file, and in ns since 1970 where known."""

    in_file_ns: int
    utc_ns: int | None = None


def _read_table(path: Path, columns: Sequence[str], time_unit: str) -> SeismometerRecord:
    try:
        table = read_columns(path, columns, time_unit)
    except RigError as error:
        said = str(error)
        for option, of_witness in _REMEDIES.items():
            said = said.replace(option, of_witness)
        raise type(error)(said) from None
    return SeismometerRecord(
        path.name,
        table.times_ns,
        np.column_stack(table.positions),
        table.names,
        table.first_ns,
        seconds(table.first_ns) > FIRST_UTC_S,
        understood=table.understood,
    )


def _read_seismic(path: Path, wanted: Sequence[str]) -> SeismometerRecord:
    try:
        import obspy
        from obspy.io.mseed import InternalMSEEDWarning
    except ImportError:
        raise MissingPackage(
            f"{path}: --witness with miniSEED or SAC (a CSV needs nothing)", "obspy"
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # what ObsPy finds damaged it delivers all the same
            warnings.simplefilter("error", InternalMSEEDWarning)
            traces = obspy.read(str(path))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except InternalMSEEDWarning as error:
        raise DataError(f"{path}: is damaged ({error}); leave its damaged records out") from None
    except Exception as error:  # ObsPy's readers raise whatever their libraries do
        raise DataError(f"{path}: is read by ObsPy as neither miniSEED nor SAC: {error}") from None
    for trace in traces:
        trace.data = np.ma.filled(np.ma.asarray(trace.data, dtype=np.float64), np.nan)
    chosen, others = _chosen(path, sorted({_name_of(trace) for trace in traces}), wanted)
    used = obspy.Stream([trace for trace in traces if _name_of(trace) in chosen and len(trace)])
    if empty := [name for name in chosen if name not in map(_name_of, used)]:
        raise DataError(f"{path}: {empty[0]} holds no samples that can be read; name another file or channel")
    try:
        used.merge(method=1, fill_value=np.nan)
    except Exception as error:  # channels of several rates
        raise DataError(f"{path}: its records cannot be joined: {error}") from None
    used.trim(
        min(trace.stats.starttime for trace in used), max(trace.stats.endtime for trace in used),
        pad=True, fill_value=np.nan,
    )  # fmt: skip
    of_name = {_name_of(trace): trace for trace in used}
    stats = of_name[chosen[0]].stats
    times_ns = np.rint(np.arange(stats.npts) * (NS_PER_S / stats.sampling_rate)).astype(np.int64)
    value = np.column_stack([_at(times_ns, stats.starttime.ns, of_name[name]) for name in chosen])
    lost = int(np.count_nonzero(np.isnan(value).any(axis=1)))
    understood = (
        f"channels: {', '.join(chosen)}, {stats.sampling_rate:.6g} samples a second",
        *([f"not used: {', '.join(others)}"] if others else []),
        *([f"missing: {lost} of {len(times_ns)} samples"] if lost else []),
    )
    sensors = {_sensor(name) for name in chosen}
    names = tuple(name.rpartition(".")[2] or name if len(sensors) == 1 else name for name in chosen)
    return SeismometerRecord(
        path.name, times_ns, value, names, stats.starttime.ns, absolute=True, understood=understood
    )


def _name_of(trace: Any) -> str:
    """NET.STA.LOC.CHA of a trace."""
    return str(trace.id) if trace.id.strip(".") else "trace"


def _at(times_ns: Ints, first_ns: int, trace: Any) -> Floats:
    """A trace's samples (n,) at times from `first_ns` on; NaN where it has none."""
    step_ns, late_ns = NS_PER_S / trace.stats.sampling_rate, trace.stats.starttime.ns - first_ns
    value = np.asarray(trace.data, dtype=np.float64)
    if len(value) == len(times_ns) and abs(late_ns) < _SAME_TICK_NS:
        return value
    own_ns = late_ns + np.arange(len(value)) * step_ns
    return np.interp(times_ns, own_ns, value, left=np.nan, right=np.nan)


def _sensor(name: str) -> str:
    """A channel's name without the letter of its direction."""
    return f"{name[:-1]}?" if "." in name else name


def _chosen(path: Path, known: Sequence[str], wanted: Sequence[str]) -> tuple[list[str], list[str]]:
    """Channels that are used, by their names in full or in part, and the others: those of one sensor.

    Raises ConfigurationError where several sensors are there and it is not said which of them is meant.
    """
    chosen: list[str] = []
    for one in wanted or ["*"]:
        matching = [name for name in known if fnmatchcase(f".{name}.", f"*.{one}.*")]
        if not matching:
            listed = (
                known
                if len({name.rpartition(".")[0] for name in known}) > 1
                else [name.rpartition(".")[2] for name in known]
            )
            raise ConfigurationError(f"{path}: has no channel {one!r}; channels: {', '.join(listed)}")
        sensors = sorted({_sensor(name) for name in matching})
        if len(sensors) > 1:
            raise ConfigurationError(
                f"{path}: holds {len(sensors)} sensors{f' named {one}' if wanted else ''}: "
                f"{', '.join(sensors)}; state one: --witness-column '{sensors[0]}'"
            )
        chosen += [name for name in matching if name not in chosen]
    return chosen, [name for name in known if name not in chosen]


_VALUES = ("first", "second", "third")
_FEWEST = 3
_PAUSE_S, _PAUSE_STEPS = 0.5, 4.0
"""A pause between arrivals that is longer than both, the second in steps, is a gap."""
_LINE = 20
"""Fewest samples of a stretch whose arrivals make a line."""
_LATE_S = 0.3
"""What arrives later than the usual by less did not wait."""
_WAITED, _MOST_TURNS = 5.0, 30
"""What is later by so many times the distance between the earliest and the usual arrivals had waited."""


def recorded_witness(reader: RecordReader, config: Configuration) -> SeismometerRecord | None:
    """Its samples on the frames' clock; None without any, or with witness.kind = 'none'."""
    if config.witness.kind == "none":
        return None
    table = reader.table(WITNESS.topic)
    if len(table) < _FEWEST:
        return None
    names = config.witness.components
    times_ns = taken(table["time_ns"], table["own_time_s"])
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
        offset_stated=True,
        understood=(
            f"columns: {', '.join(names)}",
            *([f"left out: {stray} samples not later than the previous one"] if stray else []),
        ),
    )


def taken(arrived_ns: Ints, own_s: Floats) -> Ints:
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
    taken_s = since_s.copy()
    for begin, end in pairwise(begins):
        if end - begin >= _LINE:
            part = slice(begin, end)
            taken_s[part] = _line_of(over[part], since_s[part])
    return np.asarray(arrived_ns[0] + np.rint(1e9 * taken_s).astype(np.int64))


def _line_of(over: Floats, since_s: Floats) -> Floats:
    """The line through arrivals without those that waited, maybe for minutes: nothing arrives early.

    All of them make it where none was later than their usual scatter.
    """
    line = np.polyval(np.polyfit(over, since_s, 1), over)
    kept = np.ones(len(over), dtype=np.bool_)
    for _ in range(_MOST_TURNS):
        late_s = since_s - line
        low, usual = np.quantile(late_s, (0.05, 0.25))
        now = late_s <= usual + max(_LATE_S, _WAITED * (usual - low))
        if np.count_nonzero(now) < _LINE or np.array_equal(now, kept):
            break
        kept = now
        line = np.polyval(np.polyfit(over[kept], since_s[kept], 1), over)
    return np.asarray(line)


_WELL = 1.05
"""Factor by which an uncertainty is smaller, from which on it is named."""


def witness_sentences(use: SeismometerUse) -> list[str]:
    """What a witness told, or why it was refused; and what was left out where it was read."""
    lost = [line for line in use.understood if line.startswith(("left out", "missing"))]
    return [*_told(use), *([f"Of the witness {use.source}: {'; '.join(lost)}."] if lost else [])]


def _told(use: SeismometerUse) -> list[str]:
    if not use.used:
        gain = use.gain_of_prediction
        judged = f" (gain of prediction {gain:+.3g})" if isfinite(gain) else ""
        reason = f": {use.reason}" if use.reason else ""
        sought = f"; {use.offsets_tried} offsets of its clock were tried" if use.offsets_tried else ""
        said = f"Witness of the ground {use.verdict}{reason}{judged}{sought}."
        return [f"{said} The results are the same as without it."]
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
    lines = [f"Witness of the ground: {explained}. Its response: {responses}."]
    saved = ", ".join(
        f"{plain(factor, 3)} ({quantity(name).symbol})"
        for name, factor in use.saved.items()
        if factor > _WELL
    )
    if saved:
        lines.append(f"The witness reduces the uncertainties by factors of {saved}.")
    found = f"{use.offset_s:+.5g} s, the best of {use.offsets_tried}, and " if use.offsets_tried else ""
    lines.append(
        f"Clock of the witness: {found}{with_uncertainty(*use.delay_s)} s to be added to its times, drift "
        f"{with_uncertainty(*use.clock_drift)} s/s."
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
