"""Units of columns, from names (``t [ms]``, ``phi / arcsec``) and options; contradictions are refused."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from processing.errors import ConfigurationError
from processing.units import size, unit_of_name
from rig.intake.trajectory import ANGLE_UNITS, UNSTATED_UNIT

TIME_NAME: Final = re.compile(
    r"(?:t|times?|zeit|uhrzeit|temps|tiempo|tempo|tijd|elapsed|date.*|datum.*|timestamps?|clock|unix|epoch|utc)"
    r"(?:(?:[\W_]|(?-i:[A-Z])).*)?",
    re.IGNORECASE,
)
_SPELLINGS: Final = {
    "s": "sec secs second seconds sek sekunde sekunden", "ms": "msec millisecond milliseconds millisekunden",
    "us": "usec µsec μsec microsecond microseconds mikrosekunden", "ns": "nsec nanosecond nanoseconds",
    "min": "mins minute minutes minuten", "h": "hr hour hours stunde stunden", "d": "day days tag tage",
    "deg": "° º degree degrees grad", "rad": "radian radians", "mrad": "milliradian milliradians",
    "m": "meter metre", "mm": "millimeter millimetre", "um": "micron microns", "V": "volt volts",
    "px": "pix pixel pixels", "arcsec": "″ \" asec arcsecond arcseconds bogensekunde bogensekunden",
    "arcmin": "′ ' arcminute arcminutes bogenminute bogenminuten", "dB": "db", "%": "percent",
}  # fmt: skip
_WORDS: Final = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
_CAPITALS: Final = ("s", "ms", "us", "ns", "min", "deg", "rad", "mrad", "px", "mm", "arcsec")
"""Units that are recognised in capitals, too."""
_NOT_ALONE: Final = ("m", "s", "g", "a", "v", "n", "j", "w", "d", "h", "e", "1", "min", "t")
"""Short words that are names of columns as well as units."""
_COUNTS: Final = re.compile(
    r"[^\W_]+[\W_]+(?:ticks?|frames?|samples?|counts?|cycles?|steps?|index)\W*|.*\sin\s+\S+", re.IGNORECASE
)
_BRACKETS: Final = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)|\{([^{}]*)\}|<([^<>]*)>")
_MARKS: Final = re.compile(r"\s*[/,:]\s*|\s+in\s+|_|\s+", re.IGNORECASE)
_FACTOR: Final = re.compile(
    r"(?:[*×·]|\bx|(?<=_)x)\s*(?:10+(?:\^|\*\*)?[+-]?\d*|0\.0*1|1e[+-]?\d+)(?![\w.])|\b(?:tenths?|zehntel)\b[^)\]]*",
    re.IGNORECASE,
)
"""A factor that changes the unit: ``* 1000``, tenths of a second."""


class ColumnName(NamedTuple):
    """A column's name, split into a name and a unit."""

    name: str
    """The name without the unit."""
    unit: str
    """The unit in this program's spelling (``us``); empty without one."""
    unknown: str = ""
    """Text in the unit's place that is no known unit."""


def known_unit(text: str) -> str:
    """The unit in this program's spelling, as us for ``µsec`` and deg for ``Grad``; empty for other text."""
    text = text.strip().strip(".")
    unit = _WORDS.get(text.lower(), text).replace("µ", "u").replace("μ", "u")
    if unit in ("Ms", "Gs", "Mrad", "Mm"):
        # Ms, 11 days, is hardly meant: probably ms
        return ""
    try:
        size(unit)
    except ConfigurationError:
        lower = unit.lower()
        return known_unit(lower) if lower != unit and lower in _CAPITALS else ""
    return unit


def is_time(unit: str) -> bool:
    """Whether a unit is one of time."""
    return bool(unit) and dict(size(unit).powers) == dict(size("s").powers)


def split_name(name: str) -> ColumnName:
    """Split a column's name into name and unit: the unit is in brackets, or the last word of the name."""
    text = name.strip()
    if factor := _FACTOR.search(text):
        return ColumnName(text, "", factor[0].strip())
    bracketed = [
        (match.span(), next(filter(None, match.groups()), "").strip()) for match in _BRACKETS.finditer(text)
    ]
    units = [(span, unit) for span, content in bracketed if (unit := _bracketed_unit(content))]
    # a single letter after the unit is the channel or the run
    units = [item for k, item in enumerate(units) if not k or len(item[1]) > 1]
    if len({unit for _, unit in units}) > 1:
        return ColumnName(text, "", " and ".join(text[a:b] for (a, b), _ in units))
    if units:
        ((begin, end), unit), *_ = units
        return ColumnName(" ".join(f"{text[:begin].rstrip()} {text[end:].lstrip()}".split()), unit)
    plain = _BRACKETS.sub(" ", text).strip()
    if plain.lower() not in _NOT_ALONE and (unit := _unit(plain)):
        return ColumnName(text, unit)
    if "_per_" in plain and (unit := unit_of_name(plain.lower())):
        return ColumnName(text, unit)
    for mark in () if " per " in plain else _MARKS.finditer(plain):
        rest, is_no_blank = plain[mark.end() :], bool(mark[0].strip())
        # behind a blank only the last of two words is a unit
        if (is_no_blank or (len(rest) > 1 and plain.count(" ") == 1)) and (unit := _unit(rest)):
            return ColumnName(plain[: mark.start()] if plain == text else text, unit)
        word = re.split(r"[\s_.,]", rest)[0]
        if is_no_blank and word.lower() not in _NOT_ALONE and (unit := _unit(word)):
            return ColumnName(text, unit)
    is_time_name = TIME_NAME.fullmatch(plain)
    unknown = [
        content
        for (_, end), content in bracketed
        # text in the unit's place must be a known unit: at the end of a name, and anywhere in that of a time
        if content and not content.isdecimal() and (is_time_name or end == len(text))
    ]
    quantity, slash, denominator = (part.strip() for part in plain.rpartition("/"))
    if slash and quantity and (is_time_name or " " not in denominator):
        unknown.append(denominator)
    elif is_time_name and _COUNTS.fullmatch(plain):
        unknown.append(plain.split()[-1])
    return ColumnName(plain, "", unknown[-1] if unknown else "")


def _unit(text: str) -> str:
    return "" if text.isdecimal() else known_unit(text)


def _bracketed_unit(text: str) -> str:
    """The unit in brackets: of ``ms`` or ``ms, relative``, but none of ``100 ns``."""
    return _unit(text) or _unit(re.split(r"[,;]", text)[0])


def refuse_contradiction(path: Path, title: str, by_header: str, option: str, by_option: str) -> None:
    """Raise ConfigurationError if a header and an option state two units."""
    if by_header and by_option and not _are_same_unit(by_header, by_option):
        raise ConfigurationError(
            f"{path}: {title!r} says {by_header}, {option} says {by_option}; leave the option out, or "
            "correct the header"
        )


ASSUMED_SECONDS: Final = "nothing states another"
"""The source of the unit of times that are assumed to be in s, in words."""
TIME_UNITS: Final = ("ns", "us", "ms", "s", "min", "h", "d")


def unit_of_time(path: Path, title: str, column: ColumnName, option: str) -> tuple[str, str]:
    """The unit of a column of times, and its source; raises ConfigurationError if it is invalid."""
    if option and not is_time(known_unit(option)):
        raise ConfigurationError(
            f"--time-unit {option!r} is not a unit of time; use one of {', '.join(TIME_UNITS)}"
        )
    if column.unit and not is_time(column.unit):
        raise ConfigurationError(
            f"{path}: {title!r} is in {column.unit}, which is not a unit of time; name the time column with "
            "--time, or state --rate"
        )
    stated = known_unit(option)
    refuse_contradiction(path, title, column.unit, "--time-unit", stated)
    if stated:
        return stated, "--time-unit"
    if column.unknown:
        raise ConfigurationError(
            f"{path}: {column.unknown!r} in {title!r} is not a known unit of time; state "
            f"--time-unit, one of {', '.join(TIME_UNITS)}"
        )
    return (column.unit, "its header") if column.unit else ("s", ASSUMED_SECONDS)


def unit_of_positions(
    path: Path, titles: Sequence[str], columns: Sequence[ColumnName], option: str
) -> tuple[str, str]:
    """The common unit of one or two columns of positions, and its source; raises ConfigurationError."""
    stated = known_unit(option) or option
    for title, column in zip(titles, columns, strict=True):
        if column.unknown and not stated:
            raise ConfigurationError(
                f"{path}: {column.unknown!r} in {title!r} is not a known unit; state --unit, one of "
                f"{', '.join(ANGLE_UNITS)} or any word"
            )
        refuse_contradiction(path, title, column.unit, "--unit", stated)
    units = [column.unit for column in columns]
    if len(set(units)) > 1:
        raise ConfigurationError(
            f"{path}: the positions are in {' and '.join(map(repr, units))}; both need the same unit"
        )
    source = "--unit" if stated else "its header" if units[0] else "not stated"
    return stated or units[0] or UNSTATED_UNIT, source


def _are_same_unit(unit: str, other: str) -> bool:
    try:
        return size(unit) == size(other)
    except ConfigurationError:
        return unit == other
