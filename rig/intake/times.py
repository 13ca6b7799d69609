"""A column of times as nanoseconds, exactly, and the lines of rows that are left out."""

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import MOMENT, moments_ns
from rig.intake.units import ColumnName, known_unit

SORT: Final = (
    "sort the rows or name the time column with --time; several runs need a blank line between them or a "
    "column 'run'"
)
"""What to do about times that do not increase, where nothing more is known."""
_LONGEST_S: Final = 1e9  # thirty years; 64 bits of nanoseconds hold nine times as much
_OUR_DAYS_S: Final = (7.9e8, 4.1e9)
"""1995 to 2100, since 1970."""
_EXACT: Final = 2**53
"""Largest whole number of ns that a floating-point number holds."""
_HOUR_NS: Final = 3_600_000_000_000
_HOUR_SHARE: Final = 0.01
_TWICE: Final = (
    "a row that stands there twice must be removed; of a clock whose digits do not tell the rows apart, give "
    "the rate of the rows instead (--rate HZ), or name another time column with --time"
)
_LISTED: Final = 5
"""Lines that a message names one by one."""


def placed(lines: Sequence[int]) -> str:
    """``lines 4, 9 to 12``: the first few stretches of lines."""
    stretches: list[list[int]] = []
    for line in lines:
        if stretches and line == stretches[-1][1] + 1:
            stretches[-1][1] = line
        else:
            stretches.append([line, line])
    said = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in stretches[:_LISTED])
    more = f" and {len(stretches) - _LISTED} more places" if len(stretches) > _LISTED else ""
    return f"line{'s' if len(lines) > 1 else ''} {said}{more}"


def rising(path: Path, times_ns: NDArray[np.int64], cells: Sequence[str], remedy: str) -> None:
    """Raise DataError where times do not increase."""
    if len(times_ns) < 2:
        raise DataError(f"{path}: {len(times_ns)} rows have a time; name the time column with --time")
    steps_ns = np.diff(times_ns)
    backwards = np.nonzero(steps_ns <= 0)[0]
    if len(backwards):
        row = int(backwards[0])
        step_ns = float(np.median(steps_ns))
        if abs(int(steps_ns[row]) + _HOUR_NS) < _HOUR_SHARE * _HOUR_NS + 2.0 * abs(step_ns):
            remedy = (
                "where a clock is set back from summer time, write the times with their zone (+02:00, then "
                "+01:00) or in UTC"
            )
        raise DataError(
            f"{path}: time does not increase after {cells[row]} (row {row + 1}): {cells[row + 1]} follows; "
            f"{remedy if steps_ns[row] else _TWICE}"
        )


def read_times(
    path: Path, cells: list[str], unit: str, remedy: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    """Times from the first one in ns, which of the rows have one, and the first one.

    `remedy` is said where they do not increase.
    """
    times = np.array([number(cell) for cell in cells])
    good = np.isfinite(times)
    times = times[good]
    if len(times) < 2:
        raise DataError(
            f"{path}: {len(times)} rows have a time, {cells[0]!r} is none; write dates as 2024-05-01 "
            "12:00:00, or name another time column with --time"
        )
    size_ns = round(conversion(unit, "ns"))
    with np.errstate(over="ignore", invalid="ignore"):
        backwards = np.nonzero(~(np.diff(times) >= 0))[0]
        span_s = (times[-1] - times[0]) * seconds(size_ns)
        exact = not np.abs(times).max() * size_ns < _EXACT
    if not len(backwards) and not span_s <= _LONGEST_S:
        raise DataError(
            f"{path}: the times span {span_s:.3g} s, which no decay lasts; state their unit "
            f"(--time-unit {likely_units(times[0])}), or name the time column with --time"
        )
    if not len(backwards):
        if exact:
            whole = [Decimal(cell) * size_ns for cell, kept in zip(cells, good, strict=True) if kept]
            times_ns = np.array([round(value - whole[0]) for value in whole], dtype=np.int64)
        else:
            times_ns = np.round((times - times[0]) * size_ns).astype(np.int64)
        backwards = np.nonzero(np.diff(times_ns) <= 0)[0]
    if len(backwards):
        row = int(backwards[0])
        remedy = _TWICE if times[row + 1] == times[row] and remedy is SORT else remedy
        raise DataError(
            f"{path}: time does not increase after {times[row]:.15g} {unit} (row {row + 1}): "
            f"{times[row + 1]:.15g} {unit} follows; {remedy}"
        )
    first = next(cell for cell, kept in zip(cells, good, strict=True) if kept)
    return times_ns, good, round(Decimal(first) * size_ns)


def likely_units(first: float) -> str:
    """The unit that makes a number a date of our days, and which; else those that may be meant."""
    found = [
        f"{unit}, then {datetime.fromtimestamp(since_s, UTC):%Y-%m-%d}"
        for unit in ("s", "ms", "us", "ns")
        if _OUR_DAYS_S[0] < (since_s := first * conversion(unit, "s")) < _OUR_DAYS_S[1]
    ]
    return found[0] if found else "ms, us or ns; ticks of another length have to be written in one of them"


def number(cell: str) -> float:
    """A finite number; NaN for anything else."""
    try:
        # Python reads 1_0 as ten, which no instrument means
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


M_SS: Final = "m:ss"
H_MM: Final = "h:mm"
_FORM: Final = re.compile(
    r"(?<![:\w])(?:(?P<minutes>mm?|min):(?:ss?|sec)|(?P<hours>hh?|std):(?:mm?|min))(?:[.,]\w+)?(?![:\w])",
    re.IGNORECASE,
)
_LEADING: Final = {"min": M_SS, "h": H_MM}
_HOURS_OF_DAY: Final = 24


def clock_form(
    path: Path, title: str, named: ColumnName, asked: str, cells: Sequence[str]
) -> tuple[str, str]:
    """What the times of two fields in a column are, M_SS or H_MM, and who says so; empty: there are none.

    The option or the header states it. Otherwise a fraction (``0:05.2``), a first field that is no hour of
    a day (``75:30``), or other cells with all three fields decide, if they do.

    Raises
    ------
    ConfigurationError
        Neither of them decides, or two of them disagree.
    """
    two = [cell.strip() for cell in cells if _has_two_fields(cell)]
    by_option, by_header = _stated(asked), _stated(title) or _stated(named.strange) or _stated(named.unit)
    if not two:
        if _FORM.search(asked) and cells:
            raise ConfigurationError(
                f"{path}: {title!r} has times like {cells[0]!r}, which --time-unit {asked} does not fit; "
                "leave the option out"
            )
        return "", ""
    if by_option and by_header and by_option != by_header:
        raise ConfigurationError(
            f"{path}: {title!r} says {by_header}, --time-unit says {by_option}; leave the option out, or "
            "correct the header"
        )
    stated = by_option or by_header
    fraction = next((cell for cell in two if "." in cell or "," in cell), "")
    if stated == H_MM and fraction:
        raise ConfigurationError(
            f"{path}: {fraction!r} in {title!r} has a fraction of a second and cannot be {H_MM}; state "
            f"--time-unit {M_SS}, or correct the header"
        )
    if stated:
        return stated, "--time-unit" if by_option else "its header"
    if fraction:
        return M_SS, f"{fraction} has a fraction of a second"
    late = next((cell for cell in two if int(cell.split(":")[0]) >= _HOURS_OF_DAY), "")
    if late:
        return M_SS, f"{late} is not a time of day"
    rising = [form for form in (M_SS, H_MM) if _rise(cells, form)]
    if len(two) < len(cells) and len(rising) == 1:
        return rising[0], "the others have hours, minutes and seconds"
    raise ConfigurationError(
        f"{path}: {two[0]!r} in {title!r} may be minutes and seconds or hours and minutes; state --time-unit "
        f"{M_SS} or --time-unit {H_MM}, or write it in the header: t [{M_SS}]"
    )


def _has_two_fields(cell: str) -> bool:
    found = MOMENT.fullmatch(cell.strip())
    return found is not None and not found["date"] and (found["clock"] or "").count(":") == 1


def _stated(text: str) -> str:
    """The form that an option or a header names: ``mm:ss``, ``min:s``, or its first unit alone."""
    found = _FORM.search(text)
    if found is None:
        return _LEADING.get(known_unit(text), "") if text else ""
    return M_SS if found["minutes"] else H_MM


def _rise(cells: Sequence[str], form: str) -> bool:
    times = [time for time in moments_ns(cells, minutes_first=form == M_SS) if time is not None]
    return all(a < b for a, b in pairwise(times))


_FEWEST: Final = 64
"""Samples in which two oscillations are looked for."""
_HALF_WIDTH: Final = 0.1
"""Of a line's frequency, within which what belongs to it lies, a decay's width included."""
_LEAST_BINS: Final = 4
_BOTH: Final = 0.8
"""Of the variance, that two oscillations hold if they are what the samples show."""
_LARGE: Final = 0.1
"""Of the variance, from which on the weaker one is as large as a swing, nearly."""
_OVERTONES: Final = (2, 3)
"""Ratios of frequencies that one motion has with stops or steps; higher overtones are smaller than _LARGE."""
_NEAR: Final = 0.1
_GAP: Final = 3.0
"""Steps between samples."""
_FAST: Final = 1.5
"""Times the swing's frequency."""
_LAST_OVERTONE: Final = 5
_AN_OVERTONE: Final = 2.0
"""Of a spectrum's steps: a line so near to an overtone cannot be told from it."""
_MOST_OF_THE_REST: Final = 0.5
"""Of the power beside the swing; of white noise a line's width holds a fifth at most."""
_ROUNDS: Final = 10
_FAR_FREQUENCY: Final = 2.0
"""Median residuals beyond which a frequency counts little."""
_BY_CHANCE: Final = 20.0
"""Times what n frequencies of two positions have in common by chance, 1/n of what they have not."""
_SIDELESS: Final = 12.0
"""Of Kaiser's window: a swing's line is four bins wide, and its sides lie below 1e-4 of it: those of a few
swings are no second oscillation."""
_SEEN: Final = 3e-4
"""Of the swing's amplitude; below are the last digits of the table, and the sides of the swing's own line."""


def second_frequency(times_ns: NDArray[np.int64], deflection: NDArray[np.float64]) -> str:
    """The two frequencies that the samples hold, and the remedy; empty where they are not two."""
    good = np.isfinite(deflection)
    if np.count_nonzero(good) < _FEWEST:
        return ""
    since_s = seconds(times_ns - times_ns[0])
    even_s = np.linspace(since_s[0], since_s[-1], len(since_s))
    even = np.interp(even_s, since_s[good], deflection[good])
    power = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(len(even)))) ** 2
    # what lies below three turns in the record is a drift
    power[:_LEAST_BINS] = 0.0
    total = float(power.sum())
    lines: list[tuple[float, float]] = []
    for _ in range(2):
        k = int(np.argmax(power))
        width = max(_LEAST_BINS, round(_HALF_WIDTH * k))
        near = slice(max(k - width, 0), k + width + 1)
        lines.append((k / float(even_s[-1]), float(power[near].sum())))
        power[near] = 0.0
    (first_hz, first), (second_hz, second) = sorted(lines)
    ratio = second_hz / first_hz if first_hz > 0 else 0.0
    harmonic = any(abs(ratio - overtone) < _NEAR for overtone in _OVERTONES)
    if not first + second > _BOTH * total or min(first, second) < _LARGE * total or harmonic:
        return ""
    size = (second / first) ** 0.5
    return (
        f"the samples hold two oscillations, at {first_hz:.3g} Hz and at {second_hz:.3g} Hz, the second "
        f"{size:.2g} times as large as the first, so that no half-cycle is one of a free decay; damp or "
        "filter one of them, begin where it has faded (--from), or choose a position that does not "
        "see it (--position)"
    )


def fast_oscillation(times_ns: NDArray[np.int64], deflection: NDArray[np.float64], period_s: float) -> str:
    """What is to be said of a weaker oscillation that most of what is left beside the swing is; else empty.

    It goes into the noise of a sample, and with that into every uncertainty, which name no reason.
    """
    found = _spectrum(times_ns, deflection, period_s)
    power = np.zeros(0) if found is None else np.abs(found.rest) ** 2
    rest = float(power.sum())
    if found is None or not rest > 0 or not found.swing > 0:
        return ""
    k = int(np.argmax(power))
    near = found.near(k)
    line = float(power[near].sum())
    size = (line / found.swing) ** 0.5
    if line < _MOST_OF_THE_REST * rest or size < _SEEN:
        return ""
    middle = float(np.average(np.arange(len(power))[near], weights=power[near]))
    return (
        f"the samples hold a second oscillation at {middle / found.span_s:.3g} Hz, {size:.2g} times as large "
        "as the swing: it counts as noise of the samples and widens every uncertainty; filter or damp it, "
        "or choose a position that does not see it (--position)"
    )


def fast_part(
    times_ns: NDArray[np.int64], along: NDArray[np.float64], across: NDArray[np.float64], period_s: float
) -> float:
    """The fast mode along the swing over that across it, where its directions are not at a right angle.

    So many times the positions across, taken off those along, leave the swing alone. 0 where no fast mode
    across is seen beside the noise, where what is along has nothing in common with it, or where it is an
    overtone of the swing: a swing in no plane has them in both positions.
    """
    good = np.isfinite(along) & np.isfinite(across)
    # across the swing there are no overtones of it, but a fast mode may lie beside one
    found = [_spectrum(times_ns[good], one[good], period_s, overtones=1) for one in (along, across)]
    if found[0] is None or found[1] is None:
        return 0.0
    power = np.abs(found[1].rest) ** 2
    k = int(np.argmax(power))
    turns = found[1].span_s / period_s
    if abs(k - max(round(k / turns), 1) * turns) < _AN_OVERTONE:
        return 0.0
    line = found[1].near(k)
    x, y = found[1].rest[line], found[0].rest[line]
    if not float(power[line].sum()) > _MOST_OF_THE_REST * float(power.sum()):
        return 0.0
    weight, part, common = np.ones(len(x)), 0.0, 0.0
    for _ in range(_ROUNDS):
        both, of_x, of_y = (
            float(np.sum(weight * one)) for one in ((x.conj() * y).real, np.abs(x) ** 2, np.abs(y) ** 2)
        )
        part, common = both / of_x, both**2 / (of_x * of_y)
        left = np.abs(y - part * x)
        # an overtone of the swing may lie beside the line: a frequency that is far off says little
        weight = 1.0 / (1.0 + (left / (_FAR_FREQUENCY * float(np.median(left)))) ** 2)
    return part if len(x) * common > _BY_CHANCE * (1.0 - common) else 0.0


class _Spectrum(NamedTuple):
    """Of the longest stretch without a gap: its length, the swing's power, and what is beside the swing."""

    span_s: float
    swing: float
    rest: NDArray[np.complex128]

    @staticmethod
    def near(k: float) -> slice:
        """What belongs to the line at the k-th frequency."""
        width = max(_LEAST_BINS, round(_HALF_WIDTH * k))
        return slice(max(round(k) - width, 0), round(k) + width + 1)


def _spectrum(
    times_ns: NDArray[np.int64],
    deflection: NDArray[np.float64],
    period_s: float,
    overtones: int = _LAST_OVERTONE,
) -> _Spectrum | None:
    """None where there are too few samples; the swing goes with so many overtones, itself the first."""
    good = np.isfinite(deflection)
    if np.count_nonzero(good) < _FEWEST:
        return None
    time_s, values = seconds(times_ns[good] - times_ns[0]), deflection[good]
    # across a gap a straight line would stand for the swing, and have lines of its own
    steps_s = np.diff(time_s)
    borders = np.flatnonzero(steps_s > _GAP * float(np.median(steps_s))) + 1
    longest = max(np.split(np.arange(len(time_s)), borders), key=len)
    time_s, values = time_s[longest] - time_s[longest[0]], values[longest]
    if len(time_s) < _FEWEST:
        return None
    even_s = np.linspace(0.0, time_s[-1], len(time_s))
    even = np.interp(even_s, time_s, values)
    rest = np.fft.rfft((even - even.mean()) * np.kaiser(len(even), _SIDELESS))
    turns = float(even_s[-1]) / period_s
    swing = float(np.sum(np.abs(rest[_Spectrum.near(turns)]) ** 2))
    rest[: _LEAST_BINS + 1] = 0.0
    for overtone in range(1, overtones + 1):
        rest[_Spectrum.near(overtone * turns)] = 0.0
    # what is slower is the ground or the rest position, which the fits know of, or a side of the swing's line
    rest[: round(_FAST * turns)] = 0.0
    return _Spectrum(float(even_s[-1]), swing, rest)
