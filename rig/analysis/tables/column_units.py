"""The units of a table's columns: by their headers, as stated, and never one against the other."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from processing.errors import ConfigurationError
from processing.units import size
from rig.analysis.tables.header_units import Named, is_time, known_unit
from rig.analysis.trajectory import ANGLES, NOT_STATED

NOT_STATED_TIME: Final = "nothing states another"
"""Who says that a time is in s."""
TIME_UNITS: Final = ("ns", "us", "ms", "s", "min", "h", "d")


def unit_of_time(path: Path, title: str, named: Named, asked: str) -> tuple[str, str]:
    """The unit of a column of times, and who says so. Raises ConfigurationError for another, or for two."""
    if asked and not is_time(known_unit(asked)):
        raise ConfigurationError(
            f"--time-unit {asked!r} is not a unit of time; use one of {', '.join(TIME_UNITS)}"
        )
    if named.unit and not is_time(named.unit):
        raise ConfigurationError(
            f"{path}: {title!r} is in {named.unit}, which is not a unit of time; name the time column with "
            "--time, or state --rate"
        )
    stated = known_unit(asked)
    if stated and named.unit and stated != named.unit:
        raise ConfigurationError(
            f"{path}: {title!r} says {named.unit}, --time-unit says {stated}; leave the option out, or "
            "correct the header"
        )
    if stated:
        return stated, "--time-unit"
    if named.strange:
        raise ConfigurationError(
            f"{path}: {named.strange!r} in {title!r} is not a known unit of time; state "
            f"--time-unit, one of {', '.join(TIME_UNITS)}"
        )
    return (named.unit, "its header") if named.unit else ("s", NOT_STATED_TIME)


def unit_of_positions(
    path: Path, titles: Sequence[str], named: Sequence[Named], asked: str
) -> tuple[str, str]:
    """The unit that one or two columns of positions share, and who says so. Raises ConfigurationError."""
    stated = known_unit(asked) or asked
    for title, each in zip(titles, named, strict=True):
        if each.strange and not stated:
            raise ConfigurationError(
                f"{path}: {each.strange!r} in {title!r} is not a known unit; state --unit, one of "
                f"{', '.join(ANGLES)} or any word"
            )
        if each.unit and stated and not _same(each.unit, stated):
            raise ConfigurationError(
                f"{path}: {title!r} says {each.unit}, --unit says {stated}; leave the option out, or correct "
                "the header"
            )
    units = [each.unit for each in named]
    if len(set(units)) > 1:
        raise ConfigurationError(
            f"{path}: the positions are in {' and '.join(map(repr, units))}; both need the same unit"
        )
    source = "--unit" if stated else "its header" if units[0] else "not stated"
    return stated or units[0] or NOT_STATED, source


def _same(unit: str, other: str) -> bool:
    try:
        return size(unit) == size(other)
    except ConfigurationError:
        return unit == other
