"""A record's times as dates."""

import datetime

from processing.units import seconds


def utc(time_ns: int) -> datetime.datetime:
    """Nanoseconds since 1970 as a date."""
    return datetime.datetime.fromtimestamp(seconds(time_ns), datetime.UTC)


def utc_text(time_ns: int) -> str:
    """The same to the millisecond, for a person; a damaged time that is no date as the number it is."""
    try:
        moment = utc(time_ns)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{time_ns // 1_000_000 % 1000:03d} UTC"
