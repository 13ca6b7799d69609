"""Reads what a person types: a number with its unit and its standard uncertainty."""

import re
from collections.abc import Callable, Mapping, Sequence
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
_USUAL = ("g", "mg", "mm", "um", "nm", "GPa", "MPa", "mW", "uW", "mA", "mrad", "deg", "ms")
"""What a person types, for hints."""


def quantity(text: str, unit: str = "") -> tuple[float, float | None]:
    """The number in `text`, and its standard uncertainty if it states one: ``6.05 mm ± 1 um``.

    Without a unit they are in `unit`. Raises ConfigurationError for anything else.
    """
    plain = _plain(text)
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
    u_size = None if u is None else _size(of_u or of_value, unit, text)
    return float(Decimal(value) * size), None if u_size is None else float(Decimal(u) * u_size)


def _plain(text: str) -> str:
    return text.replace("(", "").replace(")", "").strip()


def _size(stated: str | None, unit: str, text: str) -> Decimal:
    """One of the stated unit in `unit`."""
    if not stated:
        return Decimal(1)
    try:
        factor = Decimal(repr(conversion(stated, unit or "1")))
    except ConfigurationError:
        *others, last = units_like(unit, _USUAL) or ("",) if unit else ("",)
        usual = f", or {', '.join(others)}{' or ' if others else ''}{last}" if last else ""
        meant = f"; {unit} is meant{usual}" if unit else "; a number alone is needed"
        raise ConfigurationError(f"{text!r}: has the unit {stated}{meant}") from None
    # powers of ten, and what else is round, as decimals: 6.05 mm are 0.00605 m
    short = Decimal(f"{factor:.12g}")
    return short if abs(short - factor) <= factor * Decimal("1e-15") else factor


def states_unit(text: str) -> bool:
    """Whether it is a number with a unit, whichever."""
    found = _QUANTITY.fullmatch(_plain(text))
    return found is not None and bool(found[2] or found[4])


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


_FORM = re.compile(r"\s*u\(\s*([^()\s]+)\s*\)\s*/\s*([^()\s<]+)\s*<\s*([0-9][0-9.eE+-]*)\s*")
_WRITTEN = {"period0_s": "T0", "gamma_pa": "gamma", DRAG.key: "drag"}
"""How parameters are written without a special keyboard."""


@dataclass(frozen=True, slots=True)
class StopCondition:
    """The relative standard uncertainty of a parameter (its key in results) must fall below a limit."""

    parameter: str
    limit: float

    def relative(self, estimates: Mapping[str, Estimate]) -> float:
        """The relative uncertainty now; infinite where there is none."""
        value, u = estimates.get(self.parameter, (0.0, 0.0))
        return u / abs(value) if value else float("inf")

    def text(self, estimates: Mapping[str, Estimate]) -> str:
        """`u(c)/c = 0.0287 < 0.03`, or with ≥ while it does not hold."""
        name, now = _written(self.parameter), self.relative(estimates)
        shown = f"{now:.3g}" if isfinite(now) else "?"
        return f"u({name})/{name} = {shown} {'<' if now < self.limit else '≥'} {self.limit:g}"


def stop_condition(text: str) -> StopCondition:
    """Read `u(c)/c < 0.03`.

    Raises
    ------
    ValueError
        Another form, an unknown parameter, a limit that is not between 0 and 1.
    """
    found = _FORM.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r} must read u(NAME)/NAME < NUMBER, for example u(c)/c < 0.03")
    over, under = (_key(name) for name in found.groups()[:2])
    if over != under:
        raise ValueError(f"{text!r} names two parameters; write u({found[1]})/{found[1]}")
    try:
        limit = float(found[3])
    except ValueError:
        raise ValueError(f"{text!r}: {found[3]} is not a number") from None
    if not 0 < limit < 1:
        raise ValueError(f"{text!r}: {found[3]} must lie between 0 and 1, 0.03 for 3 %")
    return StopCondition(over, limit)


def stop_conditions(texts: Sequence[str], *, drag: bool) -> tuple[StopCondition, ...]:
    """Read all conditions. Raises ValueError, also for a drag that is not fitted."""
    found = tuple(stop_condition(text) for text in texts)
    for text, condition in zip(texts, found, strict=True):
        if condition.parameter == DRAG.key and not drag:
            raise ValueError(f"{text!r}: fit.drag = 'vacuum' fits none")
    return found


def _written(key: str) -> str:
    return _WRITTEN.get(key, key)


def _key(name: str) -> str:
    known = {
        spelling: parameter.key
        for parameter in (*DEFAULT_LAW.parameters, DRAG)
        for spelling in (parameter.key, parameter.symbol, _written(parameter.key))
    }
    if name not in known:
        names = ", ".join(_written(parameter.key) for parameter in (*DEFAULT_LAW.parameters, DRAG))
        raise ValueError(f"no parameter {name}; known are {names}")
    return known[name]
