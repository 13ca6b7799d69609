"""Text of cells as numbers or moments, with decimal mark and unit.

A table has one decimal mark; numbers that would fit two are refused, never guessed.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Final

from processing.errors import ConfigurationError

_EXPONENT: Final = r"(?:[eEdD][+-]?\d+)?"
_POINT: Final = re.compile(rf"[+-]?(?:\d+\.\d*|\.\d+){_EXPONENT}")
_COMMA: Final = re.compile(rf"[+-]?(?:\d+,\d*|,\d+){_EXPONENT}")
_WHOLE: Final = re.compile(rf"[+-]?\d+{_EXPONENT}")
_THOUSANDS: Final = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""A number whose comma may also stand between thousands."""
_MISSING: Final = re.compile(r"[+-]?(?:nan|inf(?:inity)?|n/?a|null|none|nat|--?|)", re.IGNORECASE)
_PLAIN_NUMBER: Final = re.compile(r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_WITH_UNIT: Final = re.compile(r"(?P<number>[+-]?[\d.,].*?)\s*(?P<unit>[^\d\s.,+-][^\d,.+]*)")
_MIN_COUNTED_ROWS: Final = 8
"""Fewest rows whose numbers in sequence are row numbers."""
_MOMENT: Final = re.compile(
    r"(?:\d{4}[-/]\d\d[-/]\d\d|\d\d\.\d\d\.\d{4})(?:[T ]\d{1,2}:\d\d.*)?|\d{1,2}:\d\d:\d\d.*"
)
"""A date, a time of day with its seconds, or both."""
_GERMAN_DAY: Final = re.compile(r"(\d\d)\.(\d\d)\.(\d{4})")
_ONE_DIGIT_HOUR: Final = re.compile(r"(?:^|(?<=[T ]))(?=\d:)")
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DAY_NS: Final = 86_400_000_000_000


def is_missing(cell: str) -> bool:
    """Whether a cell stands for a missing number: empty, or a word for none."""
    return bool(_MISSING.fullmatch(cell.strip()))


def is_number(cell: str) -> bool:
    """Whether a cell is a number with either decimal mark, or stands for a missing number."""
    return any(kind.fullmatch(cell) for kind in (_PLAIN_NUMBER, _WHOLE, _POINT, _COMMA, _MISSING))


def is_timestamp(cell: str) -> bool:
    """Whether a cell is a date, a time of day, or both."""
    return _MOMENT.fullmatch(cell) is not None


def is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or time, or a number followed by a unit."""
    if is_number(cell) or is_timestamp(cell):
        return True
    match = _WITH_UNIT.fullmatch(cell)
    return match is not None and len(match["unit"]) < 8 and is_number(match["number"])


def counts_rows(column: Sequence[str]) -> bool:
    """Whether a column counts the rows: whole numbers that increase by 1."""
    if len(column) < _MIN_COUNTED_ROWS or not all(map(str.isdecimal, column)):
        return False
    return all(int(b) - int(a) == 1 for a, b in pairwise(column))


def decimal_mark(cells: Iterable[str], where: str) -> str:
    """The only decimal mark that fits all these cells.

    Raises ConfigurationError if points and commas are both decimal marks, or if all commas may also be marks
    between thousands.
    """
    with_point, commas = "", dict[bool, str]()
    for cell in cells:
        if not with_point and _POINT.fullmatch(cell):
            with_point = cell
        elif "," in cell and _COMMA.fullmatch(cell):
            commas.setdefault(_THOUSANDS.fullmatch(cell) is None, cell)
    if commas and with_point:
        raise ConfigurationError(
            f"{where}: {next(iter(commas.values()))!r} has a decimal comma and {with_point!r} a decimal "
            "point; write one of them everywhere"
        )
    if commas and True not in commas:
        raise ConfigurationError(
            f"{where}: {commas[False]!r} may be a number with a decimal comma or one with a mark for "
            "thousands; write it with a decimal point"
        )
    return "," if commas else "."


def python_text(cell: str, decimal: str) -> str:
    """The cell in Python's number format; unchanged if it is no number."""
    if _PLAIN_NUMBER.fullmatch(cell):
        return cell
    if decimal == "," and _COMMA.fullmatch(cell):
        cell = cell.replace(",", ".")
    return re.sub(r"(?<=\d)[dD](?=[+-]?\d+$)", "e", cell)


def split_unit(column: Sequence[str]) -> tuple[str, list[str]]:
    """The unit that follows the numbers of a column (``12.5°``), and the numbers without it."""
    matches = [
        None if is_number(cell) or is_timestamp(cell) else _WITH_UNIT.fullmatch(cell) for cell in column
    ]
    matches = [match if match is not None and is_number(match["number"]) else None for match in matches]
    units = Counter(match["unit"].strip() for match in matches if match is not None)
    if not units or 2 * units.total() < len(column):
        return "", list(column)
    unit, _ = units.most_common(1)[0]
    return unit, [
        match["number"].strip() if match is not None and match["unit"].strip() == unit else cell
        for match, cell in zip(matches, column, strict=True)
    ]


def timestamps_ns(cells: Sequence[str]) -> list[int | None]:
    """Times in ns since 1970, or without a date since midnight; None for a cell that is no time.

    Times of day without a date continue over midnight: a decrease by more than half a day means that a day
    has passed.
    """
    times: list[int | None] = []
    days, previous = 0, None
    for cell in cells:
        text = _GERMAN_DAY.sub(r"\3-\2-\1", cell.strip().replace("/", "-"))
        text = _ONE_DIGIT_HOUR.sub("0", text)
        has_day = text[4:5] == "-"
        try:
            moment = datetime.fromisoformat(text if has_day else f"1970-01-01T{text}")
        except ValueError:
            times.append(None)
            continue
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        time_ns = (moment - _EPOCH) // timedelta(microseconds=1) * 1000
        if not has_day:
            days += previous is not None and time_ns < previous - _DAY_NS // 2
            previous = time_ns
            time_ns += days * _DAY_NS
        times.append(time_ns)
    return times
