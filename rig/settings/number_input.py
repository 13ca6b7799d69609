"""Reading of typed input: numbers with unit and standard uncertainty, and stop conditions."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from math import isfinite

from processing.contact import DEFAULT_LAW, DRAG
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from processing.units import conversion, units_like

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_UNIT = r"[^\s\d±+\-,.][^\s±+]*"
_QUANTITY = re.compile(rf"({_NUMBER})\s*({_UNIT})?(?:\s*(?:±|\+/?-)\s*({_NUMBER})\s*({_UNIT})?)?")
_COMMON_UNITS = ("g", "mg", "mm", "um", "nm", "GPa", "MPa", "mW", "uW", "mA", "mrad", "deg", "ms")
"""Units that people usually type, for hints."""


def read_quantity(text: str, unit: str = "") -> tuple[float, float | None]:
    """The number in `text`, and its standard uncertainty if stated, in `unit`: ``6.05 mm ± 1 um``.

    A number without a unit is in `unit`. Raises ConfigurationError for other text.
    """
    plain = _without_parentheses(text)
    match = _QUANTITY.fullmatch(plain)
    if match is None:
        if comma := re.search(r"(\d),(\d)", plain):
            pointed = plain.replace(comma[0], f"{comma[1]}.{comma[2]}")
            raise ConfigurationError(f"{text!r}: should be a number, with a point: {pointed}")
        raise ConfigurationError(
            f"{text!r}: should be a number, with ± and its uncertainty where it is known"
        )
    value, value_unit, u, u_unit = match.groups()
    size = _size(value_unit or u_unit, unit, text)
    u_size = None if u is None else _size(u_unit or value_unit, unit, text)
    return float(Decimal(value) * size), None if u_size is None else float(Decimal(u) * u_size)


def _without_parentheses(text: str) -> str:
    return text.replace("(", "").replace(")", "").strip()


def _size(stated: str | None, unit: str, text: str) -> Decimal:
    """Size of the stated unit in `unit`."""
    if not stated:
        return Decimal(1)
    try:
        factor = Decimal(repr(conversion(stated, unit or "1")))
    except ConfigurationError:
        *others, last = units_like(unit, _COMMON_UNITS) or ("",) if unit else ("",)
        hint = f", or {', '.join(others)}{' or ' if others else ''}{last}" if last else ""
        expected = f"; {unit} is meant{hint}" if unit else "; a number alone is needed"
        raise ConfigurationError(f"{text!r}: has the unit {stated}{expected}") from None
    # round factors as exact decimals, so that 6.05 mm are 0.00605 m
    short = Decimal(f"{factor:.12g}")
    return short if abs(short - factor) <= factor * Decimal("1e-15") else factor


def states_unit(text: str) -> bool:
    """Whether text is a number with any unit."""
    match = _QUANTITY.fullmatch(_without_parentheses(text))
    return match is not None and bool(match[2] or match[4])


_STOP_CONDITION = re.compile(r"\s*u\(\s*([^()\s]+)\s*\)\s*/\s*([^()\s<]+)\s*<\s*([0-9][0-9.eE+-]*)\s*")
_TYPED_NAMES = {"period0_s": "T0", "gamma_pa": "gamma", DRAG.key: "drag"}
"""Names of parameters in ASCII, by key."""


@dataclass(frozen=True, slots=True)
class StopCondition:
    """The relative standard uncertainty of a parameter (its key in results) must fall below a limit."""

    parameter: str
    limit: float

    def relative(self, estimates: Mapping[str, Estimate]) -> float:
        """The present relative uncertainty; infinite without an estimate."""
        value, u = estimates.get(self.parameter, (0.0, 0.0))
        return u / abs(value) if value else float("inf")

    def text(self, estimates: Mapping[str, Estimate]) -> str:
        """The condition with its present value: `u(c)/c = 0.0287 < 0.03`, or ≥ while it does not hold."""
        name, relative_u = _typed_name(self.parameter), self.relative(estimates)
        value = f"{relative_u:.3g}" if isfinite(relative_u) else "?"
        return f"u({name})/{name} = {value} {'<' if relative_u < self.limit else '≥'} {self.limit:g}"


def _stop_condition(text: str) -> StopCondition:
    """Read `u(c)/c < 0.03`; raises ValueError for any other form, parameter or limit."""
    match = _STOP_CONDITION.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} must read u(NAME)/NAME < NUMBER, for example u(c)/c < 0.03")
    numerator, denominator = (_key(name) for name in match.groups()[:2])
    if numerator != denominator:
        raise ValueError(f"{text!r} names two parameters; write u({match[1]})/{match[1]}")
    try:
        limit = float(match[3])
    except ValueError:
        raise ValueError(f"{text!r}: {match[3]} is not a number") from None
    if not 0 < limit < 1:
        raise ValueError(f"{text!r}: {match[3]} must lie between 0 and 1, 0.03 for 3 %")
    return StopCondition(numerator, limit)


def stop_conditions(texts: Sequence[str], *, drag: bool) -> tuple[StopCondition, ...]:
    """Read all conditions; raises ValueError for a wrong one, and for a drag that is not fitted."""
    conditions = tuple(map(_stop_condition, texts))
    for text, condition in zip(texts, conditions, strict=True):
        if condition.parameter == DRAG.key and not drag:
            raise ValueError(f"{text!r}: fit.drag = 'vacuum' fits none")
    return conditions


def _typed_name(key: str) -> str:
    return _TYPED_NAMES.get(key, key)


def _key(name: str) -> str:
    """The key of a parameter whose key, symbol or ASCII name is stated."""
    keys = {
        spelling: parameter.key
        for parameter in (*DEFAULT_LAW.parameters, DRAG)
        for spelling in (parameter.key, parameter.symbol, _typed_name(parameter.key))
    }
    if name not in keys:
        names = ", ".join(_typed_name(parameter.key) for parameter in (*DEFAULT_LAW.parameters, DRAG))
        raise ValueError(f"no parameter {name}; known are {names}")
    return keys[name]
