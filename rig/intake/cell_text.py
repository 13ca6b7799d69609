"""The text of a cell as a number, a date or a time of day, with its decimal mark and its unit.

One number format holds for a whole table; if its numbers fit two formats, nothing is guessed.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import UTC, date, datetime
from itertools import pairwise
from typing import Final, NamedTuple

from processing.errors import ConfigurationError

_EXPONENT: Final = r"(?:[eEdD][+-]?\d+)?"
_SPACES: Final = "  ’'"
_POINT: Final = re.compile(rf"[+-]?(?:\d+\.\d*|\.\d+){_EXPONENT}")
_COMMA: Final = re.compile(rf"[+-]?(?:\d+,\d*|,\d+){_EXPONENT}")
_WHOLE: Final = re.compile(rf"[+-]?\d+{_EXPONENT}")
# numbers whose digits stand in groups of three, between points, commas or spaces
_BY_POINTS: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?")
_BY_COMMAS: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?")
_BY_SPACES: Final = re.compile(rf"[+-]?\d{{1,3}}(?:[{_SPACES} ]\d{{3}})+(?:[.,]\d+)?")
_MINUS: Final = "\u2212\u2013"
_MISSING: Final = re.compile(r"[+-]?(?:nan|inf(?:inity)?|n/?a|null|none|--?|)", re.IGNORECASE)
_PLAIN_NUMBER: Final = re.compile(r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_WITH_UNIT: Final = re.compile(r"(?P<number>[+\u2212\u2013-]?[\d.,].*?)\s*(?P<unit>[^\d\s.,+-][^\d,.+]*)")
_ROW_NUMBER: Final = re.compile(r'"?\d{1,15}"?')
_MIN_COUNTED_ROWS: Final = 8
TIMESTAMP: Final = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d|\d{4}/\d\d/\d\d|\d\d\.\d\d\.\d{4})?(?:(?<=\d)[T ])?"
    r"(?P<clock>(?(date)\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?"
    r"|(?:\d{1,2}:\d\d:\d\d(?:[.,]\d+)?|\d{1,3}:\d\d(?:[.,]\d+)?)))?(?P<zone>Z|[+-]\d\d:?\d\d)?"
)
"""A date, a time of day or both; a time without a date may have minutes and seconds alone, ``75:30.5``."""


class NumberFormat(NamedTuple):
    """The number format of a table: the decimal mark, and the mark between thousands, which is removed."""

    decimal: str = "."
    thousands: str = ""

    def python_text(self, cell: str) -> str:
        """The cell in Python's number format; unchanged if it is no number."""
        if self.decimal == "." and _PLAIN_NUMBER.fullmatch(cell):
            return cell
        text = _with_ascii_minus(cell).strip(f" \t{_SPACES}")
        if _BY_SPACES.fullmatch(text):
            text = re.sub(rf"[{_SPACES} ]", "", text)
        if self.thousands and self.thousands in text:
            pattern = _BY_POINTS if self.thousands == "." else _BY_COMMAS
            # a thousands mark elsewhere is a typing error: the cell is not a number
            text = text.replace(self.thousands, "") if pattern.fullmatch(text) else f"?{text}"
        if self.decimal == "," and _COMMA.fullmatch(text):
            text = text.replace(",", ".")
        return re.sub(r"(?<=\d)[dD](?=[+-]?\d+$)", "e", text)


def _with_ascii_minus(cell: str) -> str:
    """The cell with a minus sign or en dash (of Julia, matplotlib, word processors) replaced by a hyphen."""
    return f"-{cell[1:]}" if cell[:1] in _MINUS and cell[1:2] not in ("", *_MINUS) else cell


def is_missing(cell: str) -> bool:
    """Whether a cell stands for a missing number: empty, or a word for none."""
    return bool(_MISSING.fullmatch(cell.strip()))


def is_number(cell: str) -> bool:
    """Whether a cell is a number in any format, or stands for a missing number."""
    if _PLAIN_NUMBER.fullmatch(cell):
        return True
    cell = _with_ascii_minus(cell)
    return any(
        kind.fullmatch(cell)
        for kind in (_WHOLE, _POINT, _COMMA, _BY_COMMAS, _BY_POINTS, _BY_SPACES, _MISSING)
    )


def is_timestamp(cell: str) -> bool:
    """Whether a cell is a date, a time of day, or both."""
    match = None if _PLAIN_NUMBER.fullmatch(cell) else TIMESTAMP.fullmatch(cell)
    return match is not None and bool(match["date"] or match["clock"])


def has_two_fields(cell: str) -> bool:
    """Whether a cell is a time of two fields without a date, ``12:30.5``: minutes and seconds."""
    match = TIMESTAMP.fullmatch(cell.strip())
    return match is not None and not match["date"] and (match["clock"] or "").count(":") == 1


def is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or time, or a number followed by a unit."""
    if is_number(cell) or is_timestamp(cell):
        return True
    match = _WITH_UNIT.fullmatch(cell)
    return match is not None and len(match["unit"]) < 8 and is_number(match["number"])


def counts_rows(column: Sequence[str]) -> bool:
    """Whether a column counts the rows: whole numbers that increase by 1."""
    if len(column) < _MIN_COUNTED_ROWS or not all(map(_ROW_NUMBER.fullmatch, column)):
        return False
    return all(int(b.strip('"')) - int(a.strip('"')) == 1 for a, b in pairwise(column))


def number_format(cells: Iterable[str], stated: str, where: str) -> NumberFormat:
    """The only number format that fits all these cells; `stated` is the decimal mark, or empty.

    Raises
    ------
    ConfigurationError
        Points and commas are both decimal marks, or commas may be decimal or thousands marks.
    """
    with_point, with_comma, ambiguous, has_point_groups = "", "", "", False
    mixed = {".": "", ",": ""}
    for cell in map(_with_ascii_minus, cells):
        if "." in cell and "," in cell:
            decimal = max(".,", key=cell.rindex)
            if (_BY_POINTS if decimal == "," else _BY_COMMAS).fullmatch(cell):
                mixed[decimal] = cell
        elif "," in cell and _COMMA.fullmatch(cell):
            if _BY_COMMAS.fullmatch(cell):
                ambiguous = ambiguous or cell
            else:
                with_comma = with_comma or cell
        elif "." in cell and _POINT.fullmatch(cell):
            has_point_groups |= bool(_BY_POINTS.fullmatch(cell))
            if not _BY_POINTS.fullmatch(cell):
                with_point = with_point or cell
    with_comma, with_point = with_comma or mixed[","], with_point or mixed["."]
    if stated:
        return NumberFormat(stated, {".": ",", ",": "."}[stated])
    if with_comma and with_point:
        raise ConfigurationError(
            f"{where}: {with_comma!r} has a decimal comma and {with_point!r} a decimal point; write one of "
            "them everywhere, or state --decimal"
        )
    if with_comma:
        return NumberFormat(",", ".")
    if with_point:
        return NumberFormat(".", ",")
    if ambiguous and not has_point_groups:
        raise ConfigurationError(
            f"{where}: {ambiguous!r} may be a number with a decimal comma or one with a mark for "
            "thousands; state --decimal , or --decimal ."
        )
    return NumberFormat(",", ".") if ambiguous else NumberFormat()


def split_unit(column: Sequence[str]) -> tuple[str, list[str]]:
    """The unit that follows the numbers of a column (``12.5°``), and the numbers without it."""
    found = [None if is_number(cell) or is_timestamp(cell) else _WITH_UNIT.fullmatch(cell) for cell in column]
    found = [match if match is not None and is_number(match["number"]) else None for match in found]
    units = Counter(match["unit"].strip() for match in found if match is not None)
    if not units or 2 * units.total() < len(column):
        return "", list(column)
    unit, _ = units.most_common(1)[0]
    return unit, [
        match["number"].strip() if match is not None and match["unit"].strip() == unit else cell
        for match, cell in zip(found, column, strict=True)
    ]


_SECOND_NS: Final = 1_000_000_000
_DAY_NS: Final = 86_400 * _SECOND_NS
_DAY_1970: Final = date(1970, 1, 1).toordinal()


def timestamps_ns(cells: Sequence[str]) -> list[int | None]:
    """Times in ns since 1970, or since midnight without a date; None for a cell that is neither.

    A time of two fields, ``12:30``, is one of minutes and seconds, or after a date one of hours and minutes.
    Times of day without a date continue over midnight: a decrease by more than half a day means that a day
    has passed.
    """
    times: list[int | None] = []
    days, previous = 0, None
    for cell in cells:
        match = TIMESTAMP.fullmatch(cell.strip())
        if match is None or not (match["date"] or match["clock"]):
            times.append(None)
            continue
        clock, day = _clock_ns(match["clock"] or "0:00", bool(match["date"])), _day(match["date"])
        if clock is None or (match["date"] and day is None):
            times.append(None)
            continue
        value = clock
        if day is not None:
            zone_ns = _zone_ns(match["zone"])
            if clock > _DAY_NS or abs(zone_ns) > _DAY_NS:
                times.append(None)
                continue
            value += day * _DAY_NS - zone_ns
        else:
            if previous is not None and value < previous - _DAY_NS // 2:
                days += 1
            previous = value
            value += days * _DAY_NS
        times.append(value)
    return times


def _clock_ns(text: str, after_date: bool) -> int | None:
    """A time of day in ns; None for an impossible one (12:75). The first field has no upper limit."""
    fields = text.replace(",", ".").split(":")
    counted_in_minutes = len(fields) == 2 and not after_date
    if len(fields) == 2:
        fields = [*fields, "0"] if after_date else ["0", *fields]
    hours, minutes, seconds = fields
    whole_s, _, fraction = seconds.partition(".")
    # a second 60 is a leap second
    if int(whole_s) > 60 or (int(minutes) >= 60 and not counted_in_minutes):
        return None
    total_s = (int(hours) * 60 + int(minutes)) * 60 + int(whole_s)
    return total_s * _SECOND_NS + int(f"{fraction:0<9}"[:9])


def _day(text: str | None) -> int | None:
    """Days since 1970 of a date; None without one, and for an impossible one (the 30th of February)."""
    if not text:
        return None
    try:
        if "." in text:
            return datetime.strptime(text, "%d.%m.%Y").replace(tzinfo=UTC).toordinal() - _DAY_1970
        return date.fromisoformat(text.replace("/", "-")).toordinal() - _DAY_1970
    except ValueError:
        return None


def _zone_ns(text: str | None) -> int:
    if not text or text == "Z":
        return 0
    ahead_min = 60 * int(text[1:3]) + int(text[-2:])
    return (-1 if text[0] == "-" else 1) * ahead_min * 60 * _SECOND_NS
