"""Units in D-SI, the spelling of digital calibration certificates: ``\\metre\\second\\tothe{-2}``."""

import re
from fractions import Fraction
from typing import Final

from processing.errors import ConfigurationError
from processing.units import COUNTS, D_SI, D_SI_PREFIXES, factors, split_prefix

_SYMBOLS: Final = {name: symbol for symbol, name in D_SI.items()} | {"celsius": "°C"}
_PREFIXES: Final = {name: symbol for symbol, name in D_SI_PREFIXES.items()}
_TOKEN: Final = re.compile(r"\\(?:tothe\{([^{}]*)\}|([A-Za-z]+))")
_PREFIXED: Final = {
    f"{prefix}{unit}": symbol + _SYMBOLS[unit] for prefix, symbol in _PREFIXES.items() for unit in _SYMBOLS
}
"""Prefix and unit in one word; D-SI has it for the kilogram alone, and some certificates for others."""


def in_d_si(unit: str) -> str:
    """A unit of the project's table in D-SI; counts (pixels, grey values, electrons) are of dimension one.

    Raises ConfigurationError for a text that is no unit.
    """
    words = []
    for symbol, power in factors(unit or "1"):
        prefix, rest = split_prefix(symbol.replace("μ", "u").replace("µ", "u"))
        if rest in COUNTS or rest == "1":
            continue
        word = rf"\{D_SI_PREFIXES[prefix]}\{D_SI[rest]}" if prefix else rf"\{D_SI[rest]}"
        # the one unit that has its prefix in its name
        word = word.replace(r"\kilo\gram", r"\kilogram")
        words.append(word + ("" if power == 1 else rf"\tothe{{{_text(power)}}}"))
    return "".join(words) or r"\one"


def from_d_si(text: str) -> str:
    """A unit in D-SI as the project spells it: ``mm/s^2``.

    Raises ConfigurationError for a text that is no D-SI, and for a unit that is none of the table.
    """
    tokens = list(_TOKEN.finditer(text.strip()))
    if not tokens or "".join(token[0] for token in tokens) != "".join(text.split()):
        raise ConfigurationError(f"{text!r} is not a D-SI unit, such as \\kilogram")
    found, prefix, sign = list[tuple[str, Fraction]](), "", 1
    for power, word in (token.groups() for token in tokens):
        if power is not None:
            if not found or prefix:
                raise ConfigurationError(f"{text!r} is not a D-SI unit: it has a power without a base")
            symbol, own = found[-1]
            found[-1] = symbol, own * _fraction(power, text)
        elif word == "per":
            sign = -1
        elif word in _PREFIXES and not prefix:
            prefix = _PREFIXES[word]
        else:
            symbol = (
                prefix + _SYMBOLS[word] if word in _SYMBOLS else "" if prefix else _PREFIXED.get(word, "")
            )
            if not symbol:
                raise ConfigurationError(f"{text!r}: no unit that is known here")
            split_prefix(symbol)
            found.append((symbol, Fraction(sign)))
            prefix = ""
    if prefix or not found:
        raise ConfigurationError(f"{text!r} is not a D-SI unit: it has a prefix without a unit")
    return " ".join(symbol if power == 1 else f"{symbol}^{_text(power)}" for symbol, power in found)


def _text(power: Fraction) -> str:
    return str(power) if power.denominator == 1 else str(float(power))


def _fraction(power: str, text: str) -> Fraction:
    try:
        return Fraction(power.replace("_", "."))
    except ValueError:
        raise ConfigurationError(f"{text!r} is not a D-SI unit: {power!r} is not a power") from None
