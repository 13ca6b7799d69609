"""Dates and times of day as nanoseconds."""

from collections.abc import Sequence
from datetime import UTC, date, datetime
from typing import Final

from rig.analysis.tables.numbers import MOMENT

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
