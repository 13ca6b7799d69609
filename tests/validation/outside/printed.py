"""Distance of a number from a printed one, whose digits say how well it is known."""

from math import floor, log10


def units_off(value: float, printed: str) -> float:
    """The distance in units of the last printed digit: up to a half the value rounds to what is printed."""
    digits = printed.strip().lstrip("+-")
    decimals = len(digits.partition(".")[2])
    return float(abs(value - float(printed)) * 10.0**decimals)


def tolerances_off(value: float, published: float, u: float) -> float:
    """The distance in numerical tolerances of JCGM 101:2008, 7.9.2, for two significant digits of `u`."""
    return float(abs(value - published) / (0.5 * 10.0 ** (floor(log10(u)) - 1)))
