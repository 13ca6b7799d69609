"""Numbers as text, with two digits of the uncertainty, the value to the same place, and powers of ten.

Warnings of fits, terminal, report, comparisons and Rerun all use these functions.
"""

import math
from decimal import Context, Decimal
from typing import Final, NamedTuple

NOT_KNOWN: Final = "–"
MINUS: Final = "−"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EXACT = Context(prec=1000)
"""Enough digits for the exact sum of any two floating-point numbers."""


class Rounded(NamedTuple):
    """A value and its standard uncertainty as decimal numbers, both to be multiplied by 10**exponent."""

    value: str
    u: str
    exponent: int


def rounded(value: float, u: float) -> Rounded:
    """Value and standard uncertainty to the place of the second significant digit of the uncertainty.

    The uncertainty is rounded first: 0.0996 becomes 0.10, and the value has two decimals. A power of ten is
    factored out from 10⁵ on, below 10⁻², and if the second digit of u is left of the decimal point, so that
    all printed digits are significant. Both must be finite and u above 0.
    """
    u_rounded = Decimal(f"{_decimal(u):.1e}")
    last_digit = u_rounded.adjusted() - 1
    value_rounded = _decimal(value).quantize(Decimal((0, (1,), last_digit)), context=_EXACT)
    first_digit = max(value_rounded, -value_rounded, u_rounded).adjusted()
    exponent = 0 if -3 < first_digit <= 4 and last_digit <= 0 else first_digit
    value_text, u_text = (
        f"{number.scaleb(-exponent, _EXACT):.{exponent - last_digit}f}"
        for number in (value_rounded, u_rounded)
    )
    if not value_rounded:
        value_text = value_text.lstrip("-")
    return Rounded(value_text.replace("-", MINUS), u_text, exponent)


def with_uncertainty(value: float, u: float, *, signed: bool = False) -> str:
    """`(3.73315 ± 0.00010) × 10⁻³`: value and standard uncertainty, rounded as in `rounded`.

    A value without a known uncertainty (NaN, infinite, 0) is printed alone, one that is not finite as
    "not determined". If `signed`, a positive value has a plus sign.
    """
    if not math.isfinite(value):
        return "not determined"
    plus = "+" if signed and value > 0 else ""
    if not math.isfinite(u) or u <= 0:
        return plus + plain(value, 5)
    value_text, u_text, exponent = rounded(value, u)
    text = f"{plus}{value_text} ± {u_text}"
    return f"({text}){power(exponent)}" if exponent else text


def judged_number(value: float, u: float, limit: float) -> str:
    """Number to print beside its limit, to the place of its uncertainty or a hundredth of the limit.

    The larger of the two applies: `−25.00` beside a limit of 10, where u is only 50 µarcsec.
    """
    if not math.isfinite(value) or limit <= 0:
        return with_uncertainty(value, u, signed=True)
    last_digit = math.floor(math.log10(limit)) - 2
    if u >= 10.0**last_digit:
        return with_uncertainty(value, u, signed=True)
    # a value that rounds to zero has no minus sign
    return f"{round(value, -last_digit) + 0.0:+.{max(-last_digit, 0)}f}".replace("-", MINUS)


def power(exponent: int) -> str:
    """A power of ten as a factor, `× 10⁻³`; empty for 0."""
    return f" × 10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else ""


def plain(value: float, digits: int = 4) -> str:
    """A number with the given number of significant digits; a dash for NaN (unknown)."""
    if math.isnan(value):
        return NOT_KNOWN
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == 0:
        return "0"
    # the exponent is that of the rounded number: 0.99996 with four digits is 1.000
    mantissa, _, exponent_text = f"{_decimal(value):.{digits - 1}e}".partition("e")
    exponent = int(exponent_text)
    if -3 <= exponent < max(digits, 5):
        return f"{_decimal(value):.{max(0, digits - 1 - exponent)}f}".replace("-", MINUS)
    return mantissa.replace("-", MINUS) + power(exponent)


def signed(value: float) -> str:
    """A difference: a number with its sign, `+0.12`, `−2.0 × 10⁻⁵`."""
    return ("+" if value > 0 else "") + plain(value, 2)


def decimals(value: float, places: int, *, sign: bool = False) -> str:
    """A number with `places` decimals, `−12.0`, `+0.3`; a number that rounds to zero has no minus."""
    # -0.0 + 0.0 is 0.0
    text = f"{round(value, places) + 0.0:{'+' if sign else ''}.{places}f}"
    return text.replace("-", MINUS)


def interval(low: float, high: float) -> str:
    """Both ends of an interval, with two digits more than distinguish them."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return f"{plain(low, 3)} … {plain(high, 3)}"
    digits = 2 + max(0, math.ceil(math.log10(max(abs(low), abs(high)) / (high - low))))
    exponent = math.floor(math.log10(max(abs(low), abs(high))))
    if -2 <= exponent <= 4:
        return f"{plain(low, digits)} … {plain(high, digits)}"
    unit = 10.0**exponent
    return f"({plain(low / unit, digits)} … {plain(high / unit, digits)}){power(exponent)}"


def percent(fraction: float, digits: int = 2) -> str:
    """A fraction in per cent with `digits` significant digits: `0.25 %`, `130 %`, `2.0 × 10⁻⁵ %`."""
    # -0.0 + 0.0 is 0.0
    text = f"{100 * fraction + 0.0:.{digits}g}"
    if "e+" in text:
        return f"{100 * fraction:.0f} %"
    return f"{plain(100 * fraction, digits)} %" if "e-" in text else f"{text} %"


def signed_percent(fraction: float, digits: int = 2) -> str:
    """A relative difference in per cent with its sign: `+0.25 %`, `−130 %`."""
    return ("" if fraction < 0 else "+") + percent(fraction, digits).replace("-", MINUS)


def _decimal(value: float) -> Decimal:
    """The number as Python prints it, so that 4.95 is halfway between 4.9 and 5.0."""
    return Decimal(repr(float(value)))
