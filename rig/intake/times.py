"""A column of times as nanoseconds, exactly, and the lines of rows that are left out."""

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError, DataError
from processing.units import conversion, seconds
from rig.intake.cell_text import MOMENT, moments_ns
from rig.intake.units import Named, known_unit

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
            f"{path}: time does not increase after {times[row]:.16g} {unit} (row {row + 1}): "
            f"{times[row + 1]:.16g} {unit} follows; {remedy}"
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


def clock_form(path: Path, title: str, named: Named, asked: str, cells: Sequence[str]) -> tuple[str, str]:
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
