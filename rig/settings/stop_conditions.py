"""Conditions of `session.stop_when`: a run ends once its parameters are known well enough."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from processing.contact import DEFAULT_LAW, DRAG
from processing.estimate import Estimate

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
