"""Units: their table, the reading of a unit's text, factors between units; ticks of a clock in s."""

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from functools import cache
from typing import Any, Final, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError

ARCSEC_RAD = math.pi / 648000.0
"""One arcsec in rad."""
S_PER_NS: Final = 1e-9
NS_PER_S: Final = 1e9


@overload
def seconds(ticks_ns: float | np.integer[Any]) -> float: ...
@overload
def seconds(ticks_ns: NDArray[np.int64]) -> NDArray[np.float64]: ...
def seconds(ticks_ns: Any) -> Any:
    """Ticks, a number or an array, in s. Subtract ticks before: their differences are exact as integers."""
    return ticks_ns * S_PER_NS


@overload
def nanoseconds(time_s: float) -> int: ...
@overload
def nanoseconds(time_s: NDArray[np.float64]) -> NDArray[np.int64]: ...
def nanoseconds(time_s: Any) -> Any:
    """Nearest ticks of times in s, a number or an array."""
    ticks_ns = time_s * NS_PER_S
    return np.rint(ticks_ns).astype(np.int64) if isinstance(time_s, np.ndarray) else round(ticks_ns)


Powers = Mapping[str, Fraction]


class Size(NamedTuple):
    """Size of a unit in SI units: `factor` times the product of base units to their `powers`.

    Angles, pixels, grey values and levels in dB are base units of their own, so that none equals another.
    """

    factor: float
    powers: Powers


def _si(factor: float, **powers: int) -> Size:
    return Size(factor, {name: Fraction(power) for name, power in powers.items()})


_PREFIXABLE: Final[Mapping[str, Size]] = {
    "m": _si(1.0, m=1),
    "g": _si(1e-3, kg=1),
    "s": _si(1.0, s=1),
    "A": _si(1.0, A=1),
    "V": _si(1.0, kg=1, m=2, s=-3, A=-1),
    "Hz": _si(1.0, s=-1),
    "N": _si(1.0, kg=1, m=1, s=-2),
    "Pa": _si(1.0, kg=1, m=-1, s=-2),
    "J": _si(1.0, kg=1, m=2, s=-2),
    "W": _si(1.0, kg=1, m=2, s=-3),
    "rad": _si(1.0, rad=1),
}
_OTHERS: Final[Mapping[str, Size]] = {
    "1": _si(1.0),
    "%": _si(1e-2),
    "ppm": _si(1e-6),
    "min": _si(60.0, s=1),
    "h": _si(3600.0, s=1),
    "d": _si(86400.0, s=1),
    "deg": _si(math.pi / 180.0, rad=1),
    "arcmin": _si(60.0 * ARCSEC_RAD, rad=1),
    "arcsec": _si(ARCSEC_RAD, rad=1),
    "mas": _si(1e-3 * ARCSEC_RAD, rad=1),
    "°C": _si(1.0, celsius=1),
    "K": _si(1.0, kelvin=1),
    "px": _si(1.0, px=1),
    "DN": _si(1.0, DN=1),
    "e": _si(1.0, electron=1),
    "dB": _si(1.0, dB=1),
}
_SPELLINGS: Final[Mapping[str, str]] = {
    "°": "deg", "degrees": "deg", "degree": "deg", "degC": "°C", "″": "arcsec", '"': "arcsec", "′": "arcmin",
    "'": "arcmin", "percent": "%", "sec": "s", "seconds": "s", "second": "s", "msec": "ms", "usec": "us",
    "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns", "minutes": "min", "hours": "h",
    "days": "d", "radians": "rad", "pixel": "px", "pixels": "px", "count": "DN",
    "counts": "DN",
}  # fmt: skip
_PREFIXES: Final[Mapping[str, float]] = {
    "G": 1e9, "M": 1e6, "k": 1e3, "h": 1e2, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9,
    "p": 1e-12, "f": 1e-15,
}  # fmt: skip
_SUPERSCRIPTS: Final = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵖ", "-0123456789p")
_TOKEN: Final = re.compile(
    r"\s*(?:(sqrt\(|√\(|\(|\))"  # bracket
    r"|(?:\^|\*\*)(-?[\d.]+)"  # power
    r"|([/*·])"  # operator
    r"|([^\s/*·^()√⁻⁰¹²³⁴-⁹]+)([⁻⁰¹²³⁴-⁹]*))"  # symbol, its power
)

_MAX_UNIT_CHARACTERS: Final = 80
"""Most characters of a unit."""
_IN_NAMES: Final[Mapping[str, str]] = {
    "m": "m", "m2": "m^2", "m3": "m^3", "kg": "kg", "s": "s", "s2": "s^2", "ms": "ms", "us": "us",
    "ns": "ns", "a": "A", "hz": "Hz", "rthz": "sqrt(Hz)", "n": "N", "pa": "Pa", "j": "J", "w": "W",
    "rad": "rad", "deg": "deg", "arcsec": "arcsec", "min": "min", "percent": "%", "c": "°C", "px": "px",
    "dn": "DN", "e": "e", "db": "dB", "ppm": "ppm", "k": "K",
}  # fmt: skip
_PRODUCTS_IN_NAMES: Final = (["n", "m"], ["pa", "s"])


@cache
def size(unit: str) -> Size:
    """Size of a unit in SI units. Raises ConfigurationError for a text that is no unit."""
    factor, powers = 1.0, dict[str, Fraction]()
    try:
        for symbol, power in factors(unit):
            symbol_size = _symbol_size(symbol, unit)
            factor *= symbol_size.factor ** float(power)
            for name, symbol_power in symbol_size.powers.items():
                powers[name] = powers.get(name, Fraction(0)) + symbol_power * power
    except OverflowError:
        factor = math.inf
    if not 0 < factor < math.inf:
        raise ConfigurationError(f"{unit!r} is not a unit: its power is too large")
    return Size(factor, {name: power for name, power in powers.items() if power})


@cache
def factors(unit: str) -> tuple[tuple[str, Fraction], ...]:
    """Symbols of a unit in their order, as spelled in the text, each with its power.

    Raises ConfigurationError for a text that is no unit.
    """
    if len(unit) > _MAX_UNIT_CHARACTERS:
        raise ConfigurationError(f"{unit[:_MAX_UNIT_CHARACTERS]!r} and more is not a known unit")
    tokens = [match for match in _TOKEN.finditer(unit.strip()) if match[0].strip()]
    if not any(match[4] for match in tokens) or "".join(match[0] for match in tokens).split() != unit.split():
        raise ConfigurationError(f"{unit!r} is not a known unit")
    product, later_tokens = _product(unit, [match.groups("") for match in tokens])
    if later_tokens:
        raise ConfigurationError(f"{unit!r} is not a unit: a bracket is missing")
    return tuple(product)


def conversion(unit: str, into: str) -> float:
    """Factor that converts a number in `unit` to the unit `into`.

    Raises ConfigurationError if one of them is no unit, or they are units of different quantities.
    """
    if unit == into:
        return 1.0
    unit_size, into_size = size(unit), size(into)
    if unit_size.powers != into_size.powers:
        raise ConfigurationError(f"{unit} is not a unit of the same thing as {into}")
    return unit_size.factor / into_size.factor


def units_like(unit: str, among: tuple[str, ...]) -> tuple[str, ...]:
    """Units, of those given, that measure the same quantity as `unit`."""
    return tuple(other for other in among if size(other).powers == size(unit).powers)


def unit_of_name(name: str) -> str:
    """Unit in which a name ends, as ``rad/s`` of ``rotation_rad_per_s``; empty if it has none.

    A name that consists only of a unit (``m``, ``u_c``) counts as a symbol, without a unit.
    """
    quantity, *divisors = name.split("_per_")
    words = quantity.split("_")
    count = 2 if words[-2:] in _PRODUCTS_IN_NAMES else 1
    units = [_IN_NAMES.get(word) for word in (*words[-count:], *"_".join(divisors).split("_")) if word]
    # a last n is an exponent and not newtons; a last c is a parameter except in temperatures
    is_letter = count == 1 and (words[-1] == "n" or (words[-1] == "c" and "temperature" not in words))
    if words[:-count] in ([], ["u"]) or None in units or is_letter:
        return ""
    return "/".join([" ".join(map(str, units[:count])), *map(str, units[count:])])


def in_ascii(unit: str) -> str:
    """The unit with ``^`` for raised digits and letters: ``rad^-p``."""
    return re.sub(r"[⁻⁰¹²³⁴-⁹ᵖ]+", lambda raised: f"^{raised[0].translate(_SUPERSCRIPTS)}", unit)


def _product(
    unit: str, tokens: list[tuple[str, ...]], *, bracketed: bool = False
) -> tuple[list[tuple[str, Fraction]], list[tuple[str, ...]]]:
    """Product at the start of the tokens, up to the closing bracket if `bracketed`, and later tokens."""
    product, sign = list[tuple[str, Fraction]](), 0
    while tokens and tokens[0][0] != ")":
        (bracket, _, operator, symbol, raised), *tokens = tokens
        if operator:
            if sign or not product:
                raise ConfigurationError(f"{unit!r} is not a unit: nothing stands before {operator!r}")
            sign = -1 if operator == "/" else 1
            continue
        power = Fraction(sign or 1)
        if bracket:
            inner, tokens = _product(unit, tokens, bracketed=True)
            power *= Fraction(1, 2) if bracket != "(" else 1
        elif symbol:
            inner = [(symbol, Fraction(1))]
        else:
            raise ConfigurationError(f"{unit!r} is not a unit: it has a power without a base")
        if tokens and tokens[0][1]:
            raised, tokens = tokens[0][1], tokens[1:]
        if raised:
            power *= _power(raised.translate(_SUPERSCRIPTS), unit)
        product += [(inner_symbol, inner_power * power) for inner_symbol, inner_power in inner]
        sign = 0
    if sign or not product or (bracketed and not tokens):
        raise ConfigurationError(f"{unit!r} is not a unit: it ends too early, or a bracket is missing")
    return product, tokens[1:] if bracketed else tokens


def _power(text: str, unit: str) -> Fraction:
    try:
        return Fraction(text)
    except ValueError:
        raise ConfigurationError(f"{unit!r} is not a unit: {text!r} is not a power") from None


def split_prefix(symbol: str) -> tuple[str, str]:
    """Prefix of a symbol, empty if it has none, and the symbol without it, as spelled in the table.

    Raises ConfigurationError for an unknown symbol.
    """
    symbol = _SPELLINGS.get(symbol, symbol)
    if symbol in _OTHERS or symbol in _PREFIXABLE:
        return "", symbol
    if symbol[:1] in _PREFIXES and symbol[1:] in _PREFIXABLE:
        return symbol[0], symbol[1:]
    raise ConfigurationError(f"{symbol!r} is not a known unit")


def _symbol_size(symbol: str, unit: str) -> Size:
    try:
        prefix, base = split_prefix(symbol)
    except ConfigurationError:
        raise ConfigurationError(f"{unit!r} is not a known unit") from None
    if not prefix:
        return _OTHERS.get(base) or _PREFIXABLE[base]
    base_size = _PREFIXABLE[base]
    return Size(_PREFIXES[prefix] * base_size.factor, base_size.powers)
