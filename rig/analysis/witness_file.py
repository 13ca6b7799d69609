"""A witness of the ground from a file: a table, or miniSEED and SAC through ObsPy."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import ConfigurationError, DataError, MissingPackage, RigError
from processing.fit import Witness
from processing.ticks import nanoseconds, seconds
from rig.analysis.position_table import read_columns

_SEISMIC = (".mseed", ".miniseed", ".ms", ".sac", ".seed")
FIRST_UTC_S = 1e9
"""Times of a table from which on they count from 1970: this was in 2001, and no run lasts so long."""
_SAME_TICK = 0.5
_REMEDIES: Final = {
    ", or the rows in a second: --rate HZ --position COLUMN": "",
    "name the time column with --time": "call the time column time_s",
    "--time-unit": "--witness-time-unit",
    "--position": "--witness-column",
}
"""Options of a table that is fitted, and what a witness has in their place."""


@dataclass(frozen=True)
class StatedWitness:
    """Which file holds a witness, which of its columns or channels, and what is added to its times.

    `offset_s` None: the times stand as they are, and are sought where they explain nothing. `time_unit` is
    that of a table's times, where its header does not say it.
    """

    path: Path
    columns: tuple[str, ...] = ()
    offset_s: float | None = None
    time_unit: str = ""

    def read(self) -> "WitnessRecord":
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
class WitnessRecord:
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

    def beside(self, begin: "Begin") -> tuple[Witness, bool]:
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
class Begin:
    """The first turning point that is fitted: on the clock of its file, and in ns since 1970 where known."""

    in_file_ns: int
    utc_ns: int | None = None


def _read_table(path: Path, columns: Sequence[str], time_unit: str) -> WitnessRecord:
    try:
        table = read_columns(path, columns, time_unit)
    except RigError as error:
        said = str(error)
        for option, of_witness in _REMEDIES.items():
            said = said.replace(option, of_witness)
        raise type(error)(said) from None
    return WitnessRecord(
        path.name,
        table.times_ns,
        np.column_stack(table.positions),
        table.names,
        table.first_ns,
        seconds(table.first_ns) > FIRST_UTC_S,
        understood=table.understood,
    )


def _read_seismic(path: Path, channels: Sequence[str]) -> WitnessRecord:
    try:
        from obspy import read
    except ImportError:
        raise MissingPackage(
            f"{path}: --witness with miniSEED or SAC (a CSV needs nothing)", "obspy"
        ) from None
    try:
        stream = read(str(path))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except Exception as error:  # ObsPy's readers raise whatever their libraries do
        raise DataError(f"{path}: is read by ObsPy as neither miniSEED nor SAC: {error}") from None
    known = sorted({trace.stats.channel or trace.id for trace in stream})
    if missing := [name for name in channels if name not in known]:
        raise ConfigurationError(f"{path}: has no channel {missing[0]!r}; channels: {', '.join(known)}")
    chosen = list(channels) or known
    parts = {name: [t for t in stream if (t.stats.channel or t.id) == name] for name in chosen}
    first_ns = min(trace.stats.starttime.ns for traces in parts.values() for trace in traces)
    step_ns = 1e9 / parts[chosen[0]][0].stats.sampling_rate
    last_ns = max(trace.stats.endtime.ns for traces in parts.values() for trace in traces)
    times_ns = np.rint(step_ns * np.arange(round((last_ns - first_ns) / step_ns) + 1)).astype(np.int64)
    value = np.column_stack([_on(times_ns, first_ns, step_ns, traces) for traces in parts.values()])
    lost = int(np.count_nonzero(np.isnan(value).any(axis=1)))
    understood = (
        f"channels: {', '.join(chosen)}, {1e9 / step_ns:.6g} samples a second",
        *([f"missing: {lost} of {len(times_ns)} samples"] if lost else []),
    )
    return WitnessRecord(
        path.name, times_ns, value, tuple(chosen), first_ns, absolute=True, understood=understood
    )


def _on(times_ns: Ints, first_ns: int, step_ns: float, traces: Sequence[Any]) -> Floats:
    """A channel's samples at the times of all; NaN where it has none."""
    out = np.full(len(times_ns), np.nan)
    for trace in traces:
        own_ns = trace.stats.starttime.ns - first_ns + 1e9 / trace.stats.sampling_rate * np.arange(len(trace))
        data = np.ma.filled(np.ma.asarray(trace.data, dtype=np.float64), np.nan)
        inside = (times_ns >= own_ns[0] - _SAME_TICK * step_ns) & (
            times_ns <= own_ns[-1] + _SAME_TICK * step_ns
        )
        out[inside] = np.interp(times_ns[inside], own_ns, data)
    return out
