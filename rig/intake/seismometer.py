"""Samples of an auxiliary seismometer from a file: a table, or miniSEED and SAC through ObsPy."""

import math
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from re import compile as pattern
from typing import Any, Final

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import ConfigurationError, DataError, RigError, optional_module
from processing.fit import Seismogram
from processing.units import NS_PER_S, nanoseconds, seconds
from rig.intake.table import read_columns

_SEISMIC = (".mseed", ".miniseed", ".ms", ".sac", ".seed")
FIRST_UTC_S = 1e9
"""Time in s (of the year 2001) above which times of a table count from 1970: no run lasts so long."""
_MAX_TICK_ERROR_STEPS = 0.5
"""Sampling steps by which a record may begin early or late without an overlap or a gap before it."""
_MAX_RATE_DIFFERENCE = 0.01
"""Largest relative difference of the rate by the beginnings of two records from the stated one."""
_SEED, _DATA_RECORD = pattern(rb"[0-9 \0]{6}[ A-Z]"), pattern(rb"[0-9 \0]{6}[DRQM]")
"""Beginnings of a miniSEED file and of a record with samples."""
_HEADER_BYTES, _MIN_RECORD_BYTES, _USUAL_RECORD_BYTES, _MAX_RECORD_BYTES = 64, 128, 4096, 1 << 16
_EMPTY, _DAMAGED = "records without samples", "records that cannot be decoded"
_OVERLAPPING = "samples of records that overlap others"
_REMEDIES: Final = {
    ", or the rows in a second: --rate HZ --position COLUMN": "",
    "name the time column with --time": "call the time column time_s",
    "state --time-unit": "name in the header",
    "--position": "--seismometer-column",
}
"""Options in messages on a table that is fitted, and those to name instead for a seismometer's table."""


@dataclass(frozen=True, eq=False)
class SeismometerRecord:
    """Samples of a seismometer."""

    name: str
    times_ns: Ints
    """Times (n,) since the first sample."""
    value: Floats
    """Values (n, components); NaN where one is missing."""
    names: tuple[str, ...]
    """Names of the components."""
    first_ns: int
    """Time of the first sample: since 1970 if `absolute`, else on the clock of the run's file."""
    absolute: bool
    offset_stated: bool = False
    """Whether the user has stated the offset of its clock."""
    understood: tuple[str, ...] = ()
    """Lines on how its file was read, and which rows were left out."""
    to_file_ns: int = 0
    """Time to be added to the run's times for those of the run's file."""
    to_utc_ns: int | None = None
    """Time to be added to the run's times for those since 1970; None where it is not known."""

    def seismogram(self, begin_ns: int) -> Seismogram:
        """The samples in s since the first fitted turning point, at `begin_ns` of the run's clock."""
        if not self.absolute or (self.offset_stated and self.to_utc_ns is None):
            zero_ns = begin_ns + self.to_file_ns
        elif self.to_utc_ns is not None:
            zero_ns = begin_ns + self.to_utc_ns
        else:
            # the two clocks are unrelated
            zero_ns = self.first_ns
        return Seismogram(seconds(self.times_ns + (self.first_ns - zero_ns)), self.value, self.names)


def read_seismometer(
    path: Path, columns: Sequence[str] = (), offset_s: float | None = None
) -> SeismometerRecord:
    """The samples of an auxiliary seismometer's file, of the named `columns` or channels, or of all.

    `offset_s` is added to its times; with None they are used unchanged. Raises DataError or
    ConfigurationError in one line.
    """
    record = (_read_seismic if path.suffix.lower() in _SEISMIC else _read_table)(path, columns)
    if offset_s is None:
        return record
    return replace(record, first_ns=record.first_ns + nanoseconds(offset_s), offset_stated=True)


def _read_table(path: Path, columns: Sequence[str]) -> SeismometerRecord:
    try:
        table = read_columns(path, columns)
    except RigError as error:
        message = str(error)
        for option, replacement in _REMEDIES.items():
            message = message.replace(option, replacement)
        raise type(error)(message) from None
    return SeismometerRecord(
        path.name,
        table.times_ns,
        np.column_stack(table.positions),
        table.names,
        table.first_ns,
        seconds(table.first_ns) > FIRST_UTC_S,
        understood=table.understood,
    )


def _read_seismic(path: Path, channels: Sequence[str]) -> SeismometerRecord:
    purpose = f"{path}: --seismometer with miniSEED or SAC (a CSV needs nothing)"
    obspy = optional_module("obspy", purpose, "obspy", "seismic")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: {'no such file' if not path.exists() else error.strerror}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pieces = _records(data) or [_trace_piece(trace) for trace in obspy.read(str(path))]
    except Exception as error:  # ObsPy's readers raise whatever their libraries do
        raise DataError(f"{path}: is read by ObsPy as neither miniSEED nor SAC: {error}") from None
    chosen, others = _chosen_channels(path, sorted({piece.name for piece in pieces}), channels)
    left_out = Counter[str]()
    samples = [_samples([piece for piece in pieces if piece.name == name], left_out) for name in chosen]
    if empty := [name for name, (times_ns, _) in zip(chosen, samples, strict=True) if not len(times_ns)]:
        raise DataError(f"{path}: {empty[0]} holds no samples that can be read; name another file or channel")
    times_ns = samples[0][0]
    # a sample that one component lacks is lost for all
    values = np.column_stack([_at_times(times_ns, *component) for component in samples])
    step_ns = float(np.median(np.diff(times_ns))) if len(times_ns) > 1 else math.nan
    count = round((times_ns[-1] - times_ns[0]) / step_ns) + 1 if len(times_ns) > 1 else 1
    lost = count - int(np.count_nonzero(np.isfinite(values).all(axis=1)))
    understood = (
        f"channels: {', '.join(chosen)}, {NS_PER_S / step_ns:.6g} samples a second",
        *([f"not used: {', '.join(others)}"] if others else []),
        *([f"missing: {lost} of {count} samples"] if lost else []),
        *(f"left out: {number} {reason}" for reason, number in left_out.items() if number),
    )
    sensors = {_sensor(name) for name in chosen}
    names = tuple(name.rpartition(".")[2] or name if len(sensors) == 1 else name for name in chosen)
    first_ns = int(times_ns[0])
    return SeismometerRecord(
        path.name, times_ns - first_ns, values, names, first_ns, absolute=True, understood=understood
    )


@dataclass(frozen=True)
class _Piece:
    """A miniSEED record, or a trace of another format; `name` is NET.STA.LOC.CHA."""

    name: str
    start_ns: int
    step_ns: float
    count: int
    data: bytes | Floats


def _records(data: bytes) -> list[_Piece]:
    """The records of a miniSEED file with their own times; none for another format.

    ObsPy joins records whose starts are within half a sample of those predicted by earlier ones to one trace
    and discards their times, and with them the drift of a clock, which may be seconds in some minutes.
    """
    from obspy.io.mseed.util import get_record_information

    pieces, offset = list[_Piece](), 0
    if not _SEED.match(data):
        return pieces
    while offset + _HEADER_BYTES <= len(data):
        if not _DATA_RECORD.match(data, offset):
            offset += _MIN_RECORD_BYTES
            continue
        record = data[offset : offset + _MAX_RECORD_BYTES]
        # padded to whole blocks: ObsPy's reader starts again at the beginning for any other length
        header = get_record_information(BytesIO(record.ljust(-len(record) // 128 * -128, b"\0")))
        length = header.get("record_length", _USUAL_RECORD_BYTES)
        offset += length
        if header["samp_rate"] > 0:
            name = ".".join(header[key] for key in ("network", "station", "location", "channel"))
            step_ns = NS_PER_S / header["samp_rate"]
            pieces.append(_Piece(name, header["starttime"].ns, step_ns, header["npts"], record[:length]))
    return pieces


def _trace_piece(trace: Any) -> _Piece:
    step_ns = NS_PER_S / trace.stats.sampling_rate
    values = np.ma.filled(np.ma.asarray(trace.data, dtype=np.float64), np.nan)
    name = trace.id if trace.id.strip(".") else "trace"
    return _Piece(name, trace.stats.starttime.ns, step_ns, len(values), values)


def _sensor(name: str) -> str:
    """Name of a channel's sensor: the channel's without the letter of its direction."""
    return f"{name[:-1]}?" if "." in name else name


def _chosen_channels(path: Path, names: Sequence[str], stated: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the channels to use, all of one sensor, and the others; `stated` are names in full or in part.

    Raises ConfigurationError where a stated name fits no channel, or several sensors.
    """
    chosen: list[str] = []
    for part in stated or ["*"]:
        matching = [name for name in names if fnmatchcase(f".{name}.", f"*.{part}.*")]
        if not matching:
            stations = {name.rpartition(".")[0] for name in names}
            listed = names if len(stations) > 1 else [name.rpartition(".")[2] for name in names]
            raise ConfigurationError(f"{path}: has no channel {part!r}; channels: {', '.join(listed)}")
        sensors = sorted({_sensor(name) for name in matching})
        if len(sensors) > 1:
            raise ConfigurationError(
                f"{path}: holds {len(sensors)} sensors{f' named {part}' if stated else ''}: "
                f"{', '.join(sensors)}; state one: --seismometer-column '{sensors[0]}'"
            )
        chosen += [name for name in matching if name not in chosen]
    return chosen, [name for name in names if name not in chosen]


def _samples(pieces: Sequence[_Piece], left_out: Counter[str]) -> tuple[Ints, Floats]:
    """Times in ns since 1970 and values of a channel; `left_out` counts what is not used, by its reason.

    Each record begins at its own time, with even steps to the next one if that follows it without a gap.
    """
    filled = [piece for piece in pieces if piece.count]
    left_out[_EMPTY] += len(pieces) - len(filled)
    by_start = {(piece.start_ns, piece.count): piece for piece in filled}
    distinct = [piece for _, piece in sorted(by_start.items())]
    left_out[_OVERLAPPING] += sum(piece.count for piece in filled) - sum(piece.count for piece in distinct)
    times_ns, values = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    end_ns, stretch = -math.inf, 1.0
    for piece, next_piece in zip_longest(distinct, distinct[1:]):
        decoded = _decode(piece)
        if decoded is None:
            left_out[_DAMAGED] += 1
            continue
        duration_ns = piece.count * piece.step_ns
        if next_piece is not None:
            ratio = (next_piece.start_ns - piece.start_ns) / duration_ns
            stretch = ratio if abs(ratio - 1.0) < _MAX_RATE_DIFFERENCE else 1.0
        step_ns = stretch * piece.step_ns
        piece_ns = piece.start_ns + np.rint(step_ns * np.arange(piece.count)).astype(np.int64)
        new = piece_ns > end_ns - _MAX_TICK_ERROR_STEPS * step_ns
        left_out[_OVERLAPPING] += int(np.count_nonzero(~new))
        times_ns.append(piece_ns[new])
        values.append(decoded[new])
        end_ns = max(end_ns, piece.start_ns + stretch * duration_ns)
    return np.concatenate(times_ns), np.concatenate(values)


def _decode(piece: _Piece) -> Floats | None:
    """The samples of a record; None where not all of them can be read."""
    if isinstance(piece.data, np.ndarray):
        return piece.data
    from obspy import read
    from obspy.io.mseed import InternalMSEEDWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # ObsPy only warns of records that its own check finds damaged, and returns their samples
        warnings.simplefilter("error", InternalMSEEDWarning)
        try:
            stream = read(BytesIO(piece.data), format="MSEED")
        except Exception:  # ObsPy's readers raise whatever their libraries do
            return None
    is_complete = len(stream) == 1 and len(stream[0]) == piece.count
    return np.asarray(stream[0].data, dtype=np.float64) if is_complete else None


def _at_times(times_ns: Ints, own_ns: Ints, values: Floats) -> Floats:
    """A channel's samples at the common times; NaN farther than half a step from its own."""
    after = np.clip(np.searchsorted(own_ns, times_ns), 1, max(len(own_ns) - 1, 1))
    distance_ns = np.minimum(
        *(np.abs(times_ns - own_ns[np.clip(index, 0, len(own_ns) - 1)]) for index in (after - 1, after))
    )
    interpolated = np.interp(times_ns - own_ns[0], own_ns - own_ns[0], values)
    step_ns = float(np.median(np.diff(own_ns))) if len(own_ns) > 1 else 0.0
    return np.where(distance_ns <= _MAX_TICK_ERROR_STEPS * step_ns, interpolated, np.nan)
