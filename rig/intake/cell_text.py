"""The text of a cell as a number, a date or a time of day: decimal marks, thousands marks, units behind it.

One way of writing holds for a whole table. Where its numbers leave two ways open, nothing is guessed.
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
_POINTED: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?")
_COMMAED: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?")
_SPACED: Final = re.compile(rf"[+-]?\d{{1,3}}(?:[{_SPACES} ]\d{{3}})+(?:[.,]\d+)?")
_MINUS: Final = "\u2212\u2013"
_NOT: Final = re.compile(r"[+-]?(?:nan|inf(?:inity)?|n/?a|null|none|--?|)", re.IGNORECASE)
_EASY: Final = re.compile(r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_WITH_UNIT: Final = re.compile(r"(?P<number>[+\u2212\u2013-]?[\d.,].*?)\s*(?P<unit>[^\d\s.,+-][^\d,.+]*)")
_COUNT: Final = re.compile(r'"?\d{1,15}"?')
_FEWEST_COUNTED: Final = 8
MOMENT: Final = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d|\d{4}/\d\d/\d\d|\d\d\.\d\d\.\d{4})?(?:(?<=\d)[T ])?"
    r"(?P<clock>(?(date)\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?"
    r"|(?:\d{1,2}:\d\d:\d\d(?:[.,]\d+)?|\d{1,3}:\d\d(?:[.,]\d+)?)))?(?P<zone>Z|[+-]\d\d:?\d\d)?"
)
"""A date, a time of day or both. Without a date the time may be one of minutes and seconds, ``75:30.5``."""


class Writing(NamedTuple):
    """The decimal mark of a table, and the marks between thousands that are taken out."""

    decimal: str = "."
    thousands: str = ""

    def plain(self, cell: str) -> str:
        """The cell as Python writes numbers; one that is no number is left as it is."""
        if self.decimal == "." and _EASY.fullmatch(cell):
            return cell
        text = _with_ascii_minus(cell).strip(f" \t{_SPACES}")
        if _SPACED.fullmatch(text):
            text = re.sub(rf"[{_SPACES} ]", "", text)
        if self.thousands and self.thousands in text:
            pattern = _POINTED if self.thousands == "." else _COMMAED
            # a mark elsewhere is a slip of the pen: not a number
            text = text.replace(self.thousands, "") if pattern.fullmatch(text) else f"?{text}"
        if self.decimal == "," and _COMMA.fullmatch(text):
            text = text.replace(",", ".")
        return re.sub(r"(?<=\d)[dD](?=[+-]?\d+$)", "e", text)


def _with_ascii_minus(cell: str) -> str:
    """Typesetters' minus and en dash before a number, as Julia, matplotlib and word processors write it."""
    return f"-{cell[1:]}" if cell[:1] in _MINUS and cell[1:2] not in ("", *_MINUS) else cell


def is_missing(cell: str) -> bool:
    """Whether a cell stands for a number that there is not: empty, or a word for none."""
    return bool(_NOT.fullmatch(cell.strip()))


def is_number(cell: str) -> bool:
    """Whether a cell is a number in any way of writing, or stands for a missing one."""
    if _EASY.fullmatch(cell):
        return True
    cell = _with_ascii_minus(cell)
    return any(kind.fullmatch(cell) for kind in (_WHOLE, _POINT, _COMMA, _COMMAED, _POINTED, _SPACED, _NOT))


def is_moment(cell: str) -> bool:
    """Whether a cell is a date, a time of day, or both."""
    found = None if _EASY.fullmatch(cell) else MOMENT.fullmatch(cell)
    return found is not None and bool(found["date"] or found["clock"])


def is_value(cell: str) -> bool:
    """A number, a moment, or a number with a unit behind it."""
    if is_number(cell) or is_moment(cell):
        return True
    found = _WITH_UNIT.fullmatch(cell)
    return found is not None and len(found["unit"]) < 8 and is_number(found["number"])


def counts_rows(column: Sequence[str]) -> bool:
    """Whether a column counts the rows: whole numbers, each one more than the one before."""
    if len(column) < _FEWEST_COUNTED or not all(map(_COUNT.fullmatch, column)):
        return False
    return all(int(b.strip('"')) - int(a.strip('"')) == 1 for a, b in pairwise(column))


def writing_of(cells: Iterable[str], stated: str, where: str) -> Writing:
    """The one way in which all these numbers can be written; `stated` is the decimal mark, or empty.

    Raises
    ------
    ConfigurationError
        Points and commas that both are decimal marks, or commas that may be one or the other.
    """
    point, comma, either, pointed = "", "", "", False
    mixed = {".": "", ",": ""}
    for cell in map(_with_ascii_minus, cells):
        if "." in cell and "," in cell:
            decimal = max(".,", key=cell.rindex)
            if (_POINTED if decimal == "," else _COMMAED).fullmatch(cell):
                mixed[decimal] = cell
        elif "," in cell and _COMMA.fullmatch(cell):
            if _COMMAED.fullmatch(cell):
                either = either or cell
            else:
                comma = comma or cell
        elif "." in cell and _POINT.fullmatch(cell):
            pointed |= bool(_POINTED.fullmatch(cell))
            if not _POINTED.fullmatch(cell):
                point = point or cell
    comma, point = comma or mixed[","], point or mixed["."]
    if stated:
        return Writing(stated, {".": ",", ",": "."}[stated])
    if comma and point:
        raise ConfigurationError(
            f"{where}: {comma!r} has a decimal comma and {point!r} a decimal point; write one of them "
            "everywhere, or state --decimal"
        )
    if comma:
        return Writing(",", ".")
    if point:
        return Writing(".", ",")
    if either and not pointed:
        raise ConfigurationError(
            f"{where}: {either!r} may be a number with a decimal comma or one with a mark for thousands; "
            "state "
            "--decimal , or --decimal ."
        )
    return Writing(",", ".") if either else Writing()


def unit_behind(column: Sequence[str]) -> tuple[str, list[str]]:
    """The unit that stands behind the numbers of a column (``12.5°``), and the numbers without it."""
    found = [None if is_number(cell) or is_moment(cell) else _WITH_UNIT.fullmatch(cell) for cell in column]
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
_SIXTY: Final = 60
_DAY_1970: Final = date(1970, 1, 1).toordinal()


def moments_ns(cells: Sequence[str], *, minutes_first: bool = False) -> list[int | None]:
    """Times in ns since 1970, or since midnight where no date stands; None for a cell that is no moment.

    Of two fields, ``12:30``, the first is the hour, or the minute with `minutes_first`.

    Times of day without a date go on over midnight: where one falls by more than half a day, a day has
    passed.
    """
    found: list[int | None] = []
    days, before = 0, None
    for cell in cells:
        match = MOMENT.fullmatch(cell.strip())
        if match is None or not (match["date"] or match["clock"]):
            found.append(None)
            continue
        first_of_two = minutes_first and not match["date"]
        clock, day = _clock_ns(match["clock"] or "0:00", first_of_two), _day(match["date"])
        if clock is None or (match["date"] and day is None):
            found.append(None)
            continue
        value = clock
        if day is not None:
            zone_ns = _zone_ns(match["zone"])
            if clock > _DAY_NS or abs(zone_ns) > _DAY_NS:
                found.append(None)
                continue
            value += day * _DAY_NS - zone_ns
        else:
            if before is not None and value < before - _DAY_NS // 2:
                days += 1
            before = value
            value += days * _DAY_NS
        found.append(value)
    return found


def _clock_ns(text: str, minutes_first: bool) -> int | None:
    """None for what no clock shows: 12:75, 25:61:00. Hours and leading minutes may go on counting."""
    fields = text.replace(",", ".").split(":")
    if len(fields) == 2:
        # only seconds have a fraction
        fields = ["0", *fields] if minutes_first or "." in text or "," in text else [*fields, "0"]
    hours, minutes, in_s = fields
    whole, _, part = in_s.partition(".")
    # a second 60 is a leap second
    if int(whole) > _SIXTY or (int(minutes) >= _SIXTY and not minutes_first):
        return None
    whole_s = (int(hours) * 60 + int(minutes)) * 60 + int(whole)
    return whole_s * _SECOND_NS + int(f"{part:0<9}"[:9])


def _day(text: str | None) -> int | None:
    """None for a day that there is not, the 30th of February."""
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
