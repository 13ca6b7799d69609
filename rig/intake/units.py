"""Units of columns, from names (``t [ms]``, ``phi / arcsec``) and options; contradictions are refused."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from processing.errors import ConfigurationError
from processing.units import size, unit_of_name
from rig.intake.trajectory import ANGLES, NOT_STATED

TIME_NAME: Final = re.compile(
    r"(?:t|times?|zeit|uhrzeit|temps|tiempo|tempo|tijd|elapsed|date.*|datum.*|timestamps?|clock|unix|epoch|utc)"
    r"(?:(?:[\W_]|(?-i:[A-Z])).*)?",
    re.IGNORECASE,
)
_PREFIXES: Final = {"": "", "milli": "m", "mili": "m", "micro": "u", "mikro": "u", "nano": "n", "centi": "c"}
_LONG_SPELLINGS: Final = {
    "s": "sec secs second seconds sek sekunde sekunden seconde secondes segundo segundos secondi seconden",
    "m": "meter metre meters metres",
    "rad": "radian radians radiant",
    "V": "volt volts",
}
_SPELLINGS: Final = {
    "s": "s", "ms": "msec msecs msek millis millis()", "us": "usec usecs µsec μsec micros micros()",
    "ns": "nsec nsecs nanos", "min": "mins minute minutes minuten minutos minuti",
    "h": "hr hrs hour hours stunde stunden heures horas", "d": "day days tag tage",
    "deg": "° º degs degree degrees grad grados gradi degrés", "um": "micron microns",
    "px": "pix pixel pixels",
    "arcsec": "″ \" asec arcsecs arcsecond arcseconds bogensekunde bogensekunden", "dB": "db", "%": "percent",
    "arcmin": "′ ' arcmins arcminute arcminutes bogenminute bogenminuten",
}  # fmt: skip
_WORDS: Final = {
    prefix + word: symbol + unit
    for unit, words in _LONG_SPELLINGS.items()
    for word in words.split()
    for prefix, symbol in _PREFIXES.items()
} | {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
_CAPITALS: Final = ("s", "ms", "us", "ns", "min", "deg", "rad", "mrad", "px", "mm", "arcsec")
"""Units that are recognised in capitals, too."""
_NOT_ALONE: Final = ("m", "s", "g", "a", "v", "n", "j", "w", "d", "h", "e", "1", "min", "t")
"""Short words that are names of columns as well as units."""
_CLEAR_UNITS: Final = {
    *_WORDS, "ms", "us", "µs", "μs", "ns", "deg", "rad", "mrad", "urad", "nrad", "arcsec", "mm", "cm",
} - {
    "s", "second", "minute", "hour", "day", "tag", "tage", "grad", "degree", "db", "meter", "'", '"',
}  # fmt: skip
"""Words that are units anywhere in a name, because they are hardly other words."""
_CLEAR_IN_TIMES: Final = ("s", "min", "h")
"""Words that are units in the name of a time."""
_COUNTS: Final = re.compile(
    r"[^\W_]+[\W_]+(?:ticks?|frames?|samples?|counts?|cycles?|jiffies|steps?|index)\W*|.*\sin\s+\S+",
    re.IGNORECASE,
)
_BRACKETS: Final = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)|\{([^{}]*)\}|<([^<>]*)>")
_UNIT_MARKS: Final = re.compile(r"\s*[/,:;]\s*|\s+in\s+|_", re.IGNORECASE)
_MARKS: Final = re.compile(rf"{_UNIT_MARKS.pattern}|[\s.#*–-]+|(?-i:(?<=[a-zß-ÿ])(?=[A-Z]))", re.IGNORECASE)


_SEPARATE_PREFIX: Final = re.compile(
    r"\b(milli|mili|micro|mikro|nano|centi|deci)[\s-]+(?=[a-z])", re.IGNORECASE
)
"""A prefix that is separated from its unit."""
_FACTOR: Final = re.compile(
    r"(?:\s*[*×·]|(?<=[\s)\]_])x)\s*(?:10+(?:\^|\*\*)?[+-]?\d*|0\.0*1|1e[+-]?\d+)(?![\w.])|"
    r"\w*(?:tenth|hundredth|thousandth|millionth|zehntel|hundertstel|tausendstel|dixi[èe]me|[cm](?:ent|ill)i[èe]me|"
    r"d[ée]cim[ao]|cent[ée]sim[ao]|mil[ée]sim[ao]|mill[ée]sim[ao])s?(?:\s+\w+)*",
    re.IGNORECASE,
)
"""A factor that changes the unit: ``* 1000``, tenths of a second."""


class ColumnName(NamedTuple):
    """A column's name without the unit, and the unit in this program's spelling (``us``); empty without one.

    `unknown` is text in the unit's place that is no known unit.
    """

    name: str
    unit: str
    unknown: str = ""


def known_unit(text: str) -> str:
    """The unit in this program's spelling, as us for ``µsec`` and deg for ``Grad``; empty for other text."""
    text = text.strip().strip(".")
    unit = _WORDS.get(text.lower(), text).replace("µ", "u").replace("μ", "u")
    if unit in ("Ms", "Gs", "Mrad", "Mm"):
        # probably ms, not really 11 days: left unknown
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
    """Split a column's name into name and unit."""
    text = _SEPARATE_PREFIX.sub(r"\1", name.strip())
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
    if split := _split_plain_name(plain):
        return ColumnName(split[0] if plain == text else text, split[1])
    of_time = TIME_NAME.fullmatch(plain)
    unknown = [
        content
        for (_, end), content in bracketed
        # text in the unit's place must be a known unit: at the end of a name, and anywhere in that of a time
        if content and not content.isdecimal() and (of_time or end == len(text))
    ]
    quantity, slash, denominator = (part.strip() for part in plain.rpartition("/"))
    if slash and quantity and (of_time or " " not in denominator):
        unknown.append(denominator)
    elif of_time and _COUNTS.fullmatch(plain):
        unknown.append(plain.split()[-1])
    return ColumnName(plain, "", unknown[-1] if unknown else "")


def _unit(text: str) -> str:
    return "" if text.isdecimal() else known_unit(text)


def _bracketed_unit(text: str) -> str:
    """The unit in brackets: of ``ms``, ``ms, relative`` or ``in ms``, but none of ``100 ns``."""
    words = [] if re.search(r"\d", text) else re.split(r"[\s,;()]+", text)
    words = [word for k, word in enumerate(words) if len(word) > 1 or not k or word in _NOT_ALONE]
    return _unit(text) or next((unit for word in words if (unit := known_unit(word))), "")


def _split_plain_name(text: str) -> tuple[str, str] | None:
    """Name and unit, if a unit follows a mark, or stands anywhere if it is clearly one; else None."""
    if text.lower() not in _NOT_ALONE and (unit := _unit(text)):
        return text, unit
    if "_per_" in text and (unit := unit_of_name(text.lower())):
        return text, unit
    for mark in () if " per " in text else (None, *_MARKS.finditer(text)):
        begin, end = (0, 0) if mark is None else mark.span()
        rest = text[end:]
        sure = mark is not None and _UNIT_MARKS.fullmatch(mark[0])
        if not sure and text[:begin].endswith(tuple("0123456789")):
            # a number before the unit, as in "every 50 ms"
            continue
        if sure and (unit := _unit(rest)):
            return text[:begin], unit
        for part in (rest.split(" ")[0], _MARKS.split(rest)[0]):
            word = part.lower()
            is_clear = word in _CLEAR_UNITS or ("/" in part and word.split("/")[0] in _CLEAR_UNITS | {"m"})
            if (is_clear or (mark and word in _CLEAR_IN_TIMES and TIME_NAME.fullmatch(text))) and (
                unit := known_unit(word if word in _CLEAR_UNITS else part)
            ):
                return text, unit
    return None


def refuse_contradiction(path: Path, title: str, by_header: str, option: str, by_option: str) -> None:
    """Raise ConfigurationError if a header and an option state two units."""
    if by_header and by_option and not _are_same_unit(by_header, by_option):
        raise ConfigurationError(
            f"{path}: {title!r} says {by_header}, {option} says {by_option}; leave the option out, or "
            "correct the header"
        )


NOT_STATED_TIME: Final = "nothing states another"
"""Source of the unit of times that are assumed to be in s."""
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
    return (column.unit, "its header") if column.unit else ("s", NOT_STATED_TIME)


def unit_of_positions(
    path: Path, titles: Sequence[str], columns: Sequence[ColumnName], option: str
) -> tuple[str, str]:
    """The common unit of one or two columns of positions, and its source; raises ConfigurationError."""
    stated = known_unit(option) or option
    for title, column in zip(titles, columns, strict=True):
        if column.unknown and not stated:
            raise ConfigurationError(
                f"{path}: {column.unknown!r} in {title!r} is not a known unit; state --unit, one of "
                f"{', '.join(ANGLES)} or any word"
            )
        refuse_contradiction(path, title, column.unit, "--unit", stated)
    units = [column.unit for column in columns]
    if len(set(units)) > 1:
        raise ConfigurationError(
            f"{path}: the positions are in {' and '.join(map(repr, units))}; both need the same unit"
        )
    source = "--unit" if stated else "its header" if units[0] else "not stated"
    return stated or units[0] or NOT_STATED, source


def _are_same_unit(unit: str, other: str) -> bool:
    try:
        return size(unit) == size(other)
    except ConfigurationError:
        return unit == other
