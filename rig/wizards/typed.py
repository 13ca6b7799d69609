"""Reads what a person types: a number with its unit and its standard uncertainty, a word, a file."""

import re
from collections.abc import Callable
from decimal import Decimal
from typing import NamedTuple

from processing.errors import ConfigurationError

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_UNIT = r"[A-Za-zµμ°]+"
_QUANTITY = re.compile(rf"({_NUMBER})\s*({_UNIT})?(?:\s*(?:±|\+/?-)\s*({_NUMBER})\s*({_UNIT})?)?")
_PREFIXES = {
    "": "1", "k": "1e3", "M": "1e6", "G": "1e9", "c": "1e-2", "m": "1e-3", "u": "1e-6", "µ": "1e-6",
    "μ": "1e-6", "n": "1e-9",
}  # fmt: skip
_OF_UNIT = {"kg": ("g", "1e-3"), "Pa": ("Pa", "1"), "m": ("m", "1"), "s": ("s", "1"), "W": ("W", "1"),
            "A": ("A", "1"), "us": ("s", "1e6")}  # fmt: skip
"""Symbol that takes the prefixes, and its size in the unit."""
_ANGLES = {
    "rad": "1",
    "mrad": "1e-3",
    "urad": "1e-6",
    "deg": "0.017453292519943295",
    "°": "0.017453292519943295",
}
_SHOWN = {"kg": "g or mg", "m": "mm, um or nm", "Pa": "GPa or MPa", "W": "mW or uW", "A": "mA",
          "rad": "mrad or deg", "s": "ms", "us": "ms"}  # fmt: skip


class Quantity(NamedTuple):
    """A number and its standard uncertainty; `u` is None if none was stated."""

    value: float
    u: float | None


def quantity(text: str, unit: str = "") -> Quantity:
    """The number in `text`, which may state a unit and an uncertainty: ``6.05 mm ± 1 um``.

    Without a unit it is in `unit`. Raises ConfigurationError for anything else.
    """
    plain = text.replace("(", "").replace(")", "").strip()
    found = _QUANTITY.fullmatch(plain)
    if found is None:
        if comma := re.search(r"(\d),(\d)", plain):
            pointed = plain.replace(comma[0], f"{comma[1]}.{comma[2]}")
            raise ConfigurationError(f"{text!r}: should be a number, with a point: {pointed}")
        raise ConfigurationError(
            f"{text!r}: should be a number, with ± and its uncertainty where it is known"
        )
    value, of_value, u, of_u = found.groups()
    size = _size(of_value or of_u, unit, text)
    return Quantity(
        float(Decimal(value) * size),
        None if u is None else float(Decimal(u) * _size(of_u or of_value, unit, text)),
    )


def _size(stated: str | None, unit: str, text: str) -> Decimal:
    """One of the stated unit in `unit`."""
    if not stated or stated == unit:
        return Decimal(1)
    if unit == "rad" and stated in _ANGLES:
        return Decimal(_ANGLES[stated])
    symbol, size = _OF_UNIT.get(unit, ("", ""))
    prefix = stated.removesuffix(symbol) if symbol and stated.endswith(symbol) else None
    if prefix is None or prefix not in _PREFIXES:
        takes = (
            f"; {unit} is meant, or {_SHOWN[unit]}" if unit in _SHOWN else ", and a number alone is wanted"
        )
        raise ConfigurationError(f"{text!r}: has the unit {stated}{takes}")
    return Decimal(_PREFIXES[prefix]) * Decimal(size)


def number(unit: str = "", *, least: float | None = None) -> Callable[[str], float]:
    """Reads a number without uncertainty, in `unit`; `least` is the smallest that is taken."""

    def read(text: str) -> float:
        value, u = quantity(text, unit)
        if u is not None:
            raise ConfigurationError(f"{text!r}: state the number alone")
        if least is not None and value < least:
            raise ConfigurationError(f"{text!r}: should be {least:g} {unit}".rstrip() + " or more")
        return value

    return read


def optional(read: Callable[[str], float]) -> Callable[[str], float | None]:
    """Reads the same; nothing for an empty answer."""
    return lambda text: read(text) if text else None


def word(text: str) -> str:
    """Any text."""
    return text
