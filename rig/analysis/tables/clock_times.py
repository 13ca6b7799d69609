"""Times of two fields, ``12:30``: minutes and seconds, or hours and minutes, but never a guess."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from processing.errors import ConfigurationError
from rig.analysis.tables.header_units import Named, known_unit
from rig.analysis.tables.moments import moments_ns
from rig.analysis.tables.numbers import MOMENT

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
