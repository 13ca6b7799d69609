"""The unit that a column's name states: ``t [ms]``, ``time_ms``, ``phi / arcsec``, ``Zeit in µs``,
``milliseconds``.
"""

import re
from typing import Final, NamedTuple

from processing.errors import ConfigurationError
from processing.units import size

_BRACKETS: Final = re.compile(r"^(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\[\]()]*?)\s*[\])]\s*$")
_AFTER: Final = re.compile(
    r"^(?P<name>.*\S)(?:\s*/\s*|\s+in\s+|[,:]\s+|_)(?P<unit>[^\s_,/]+)$", re.IGNORECASE
)
_WORDS: Final = {
    "sekunde": "s", "sekunden": "s", "sek": "s", "secs": "s", "minute": "min", "minuten": "min",
    "mins": "min", "stunde": "h", "stunden": "h", "hour": "h", "hr": "h", "hrs": "h", "tag": "d",
    "tage": "d", "day": "d", "millisekunden": "ms", "millisecond": "ms", "millis": "ms", "msecs": "ms",
    "mikrosekunden": "us", "microsecond": "us", "micros": "us", "usecs": "us", "µsec": "us",
    "μsec": "us", "nanosekunden": "ns", "nanosecond": "ns", "nanos": "ns", "nsec": "ns", "nsecs": "ns",
    "grad": "deg", "degs": "deg", "º": "deg", "radian": "rad", "radiant": "rad",
    "bogensekunden": "arcsec", "arcsecond": "arcsec", "arcseconds": "arcsec", "bogenminuten": "arcmin",
    "arcminute": "arcmin", "arcminutes": "arcmin", "asec": "arcsec", "volt": "V", "volts": "V",
    "millivolt": "mV", "millivolts": "mV", "meter": "m", "metre": "m", "meters": "m", "metres": "m",
    "millimeter": "mm", "millimetre": "mm", "millimeters": "mm", "millimetres": "mm", "micrometer": "um",
    "micrometre": "um", "micron": "um", "microns": "um", "centimeter": "cm", "pix": "px", "db": "dB",
    "milliradian": "mrad", "milliradians": "mrad", "microradian": "urad", "microradians": "urad",
}  # fmt: skip
_SPELLED: Final = {
    "sec": "s", "seconds": "s", "second": "s", "msec": "ms", "usec": "us", "milliseconds": "ms",
    "microseconds": "us", "nanoseconds": "ns", "minutes": "min", "hours": "h", "days": "d", "°": "deg",
    "degrees": "deg", "degree": "deg", "″": "arcsec", '"': "arcsec", "′": "arcmin", "'": "arcmin",
    "radians": "rad", "pixel": "px", "pixels": "px", "percent": "%",
}  # fmt: skip
"""Units that `processing.units` knows under two names."""
_CAPITALS: Final = ("s", "sec", "ms", "us", "ns", "deg", "rad", "px", "seconds", "mm", "arcsec")
_ALONE: Final = ("m", "s", "g", "a", "v", "n", "j", "w", "d", "h", "e", "1", "min", "t")
"""Letters that are names of columns as well as units."""


class Named(NamedTuple):
    """A column's name without the unit, and the unit as written here (``us``); empty where it states none.

    `strange`: what stands in the unit's place and is none that is known.
    """

    name: str
    unit: str
    strange: str = ""


def known_unit(text: str) -> str:
    """The unit as it is written here (``µsec``: us, ``Grad``: deg); empty for what is none."""
    text = text.strip().strip(".")
    unit = _WORDS.get(text.lower(), text).replace("µ", "u").replace("μ", "u")
    try:
        size(unit)
    except ConfigurationError:
        lower = unit.lower()
        # some instruments write everything in capitals; none of these is another unit then
        if lower != unit and lower in _CAPITALS:
            return known_unit(lower)
        return ""
    return _SPELLED.get(unit, unit)


def named_unit(name: str) -> Named:
    """Take a column's name apart."""
    text = name.strip()
    if found := _BRACKETS.match(text):
        unit = known_unit(found["unit"])
        return Named(found["name"], unit, "" if unit or not found["unit"] else found["unit"])
    if found := _AFTER.match(text):
        unit = known_unit(found["unit"])
        # what follows a slash is meant as a unit, what follows an underscore may be anything
        slash = "/" in text
        if unit:
            return Named(found["name"], unit)
        return Named(text, "", found["unit"] if slash else "")
    if text.lower() not in _ALONE and (unit := known_unit(text)):
        return Named(text, unit)
    return Named(text, "")
