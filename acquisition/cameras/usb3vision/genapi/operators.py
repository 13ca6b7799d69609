"""Arithmetic of formulas: 64-bit integers that overflow, and floating point."""

import math
from collections.abc import Callable, Mapping
from typing import Final

Number = int | float


def to_int64(value: int) -> int:
    """The signed 64-bit integer with the same lowest 64 bits."""
    return (value + (1 << 63)) % (1 << 64) - (1 << 63)


def truncated(value: Number) -> int:
    """Integer part, as by a cast in C++ on x86-64: values beyond 64 bits become the smallest integer."""
    if isinstance(value, int):
        return to_int64(value)
    if not math.isfinite(value) or abs(value) >= 2.0**63:
        return -(1 << 63)
    return int(value)


def rounded(value: Number) -> int:
    """The nearest integer, halves away from zero, as EMVA's reference writes a float into an integer."""
    if isinstance(value, int) or not math.isfinite(value):
        return truncated(value)
    return truncated(math.copysign(math.floor(abs(value) + 0.5), value))


def _quotient(left: Number, right: Number) -> Number:
    if right == 0:
        raise ZeroDivisionError
    if isinstance(left, int) and isinstance(right, int):
        sign = -1 if (left < 0) != (right < 0) else 1
        return sign * (abs(left) // abs(right))
    return left / right


def _remainder(left: Number, right: Number) -> Number:
    if right == 0:
        raise ZeroDivisionError
    if isinstance(left, int) and isinstance(right, int):
        return abs(left) % abs(right) * (-1 if left < 0 else 1)
    return math.fmod(left, right) if math.isfinite(left) else math.nan


def _power(left: Number, right: Number) -> Number:
    try:
        result = math.pow(left, right)
    except OverflowError:
        result = math.inf
    except ValueError:
        result = math.nan
    if not (isinstance(left, int) and isinstance(right, int)):
        return result
    # integers are calculated exactly; beyond 64 bits the result is that of the cast
    return left**right if right >= 0 and abs(result) < 2.0**63 else truncated(result)


def _bits(operate: Callable[[int, int], int]) -> Callable[[Number, Number], Number]:
    return lambda left, right: to_int64(operate(truncated(left), truncated(right)))


BINARY: Final[Mapping[str, Callable[[Number, Number], Number]]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _quotient,
    "%": _remainder,
    "**": _power,
    "&": _bits(lambda a, b: a & b),
    "|": _bits(lambda a, b: a | b),
    "^": _bits(lambda a, b: a ^ b),
    "<<": _bits(lambda a, b: a << (b & 63)),
    ">>": _bits(lambda a, b: a >> (b & 63)),
    "=": lambda a, b: int(a == b),
    "<>": lambda a, b: int(a != b),
    "<": lambda a, b: int(a < b),
    ">": lambda a, b: int(a > b),
    "<=": lambda a, b: int(a <= b),
    ">=": lambda a, b: int(a >= b),
}


def _round(value: float, digits: float = 0.0) -> float:
    scale = 10.0 ** int(digits)
    return math.copysign(math.floor(abs(value) * scale + 0.5) / scale, value)


def _logarithm(function: Callable[[float], float]) -> Callable[[float], float]:
    def logarithm(value: float) -> float:
        return -math.inf if value == 0 else function(value)

    return logarithm


FUNCTIONS: Final[Mapping[str, Callable[..., Number]]] = {
    "ABS": abs,
    "SGN": lambda x: (x > 0) - (x < 0),
    "NEG": lambda x: -x,
    "ROUND": _round,
    "TRUNC": math.trunc,
    "FLOOR": math.floor,
    "CEIL": math.ceil,
    "SQRT": math.sqrt,
    "EXP": math.exp,
    "LN": _logarithm(math.log),
    "LG": _logarithm(math.log10),
    "SIN": math.sin,
    "COS": math.cos,
    "TAN": math.tan,
    "ASIN": math.asin,
    "ACOS": math.acos,
    "ATAN": math.atan,
}
CONSTANTS: Final[Mapping[str, float]] = {"PI": math.pi, "E": math.e}
