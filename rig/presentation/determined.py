"""How a parameter is shown that the data may not determine: value, interval or bound."""

from collections.abc import Mapping
from typing import Any

from processing.estimate import WELL_DETERMINED
from rig.presentation.numbers import number, plain
from rig.presentation.quantities import law_parameters, quantity


def determined_text(name: str, value: float, u: float, verdicts: Mapping[str, Mapping[str, Any]]) -> str:
    """Value and uncertainty where the data determine the parameter, else its interval or bound.

    A surface energy is c times what is known of the apparatus, and shares c's verdict.
    """
    shown = quantity(name)
    is_energy = name.startswith("surface_energy")
    verdict = verdicts.get("c" if is_energy else name)
    if verdict is None or verdict["verdict"] == "determined":
        return shown.text(value, u)
    per_parameter = value / number(verdict, "value") if is_energy else 1.0
    return bound_text(verdict, shown.factor * per_parameter)


def series_verdicts(combined: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Verdicts on a series' parameters by their 95 % intervals, in the form of a run's."""
    found = {}
    for name, item in combined.items():
        value, half = number(item, "value"), number(item, "expanded_uncertainty_95")
        low, high = value - half, value + half
        kind = "determined"
        if number(item, "standard_uncertainty") > WELL_DETERMINED * abs(value):
            kind = "upper bound" if low <= 0 and law_parameters()[name].lower == 0 else "interval"
        found[name] = {"verdict": kind, "value": value, "lower_95": low, "upper_95": high}
    return found


def bound_text(verdict: Mapping[str, Any], scale: float = 1.0) -> str:
    """`between ... and ...` or a bound, 95 %."""
    low, high = number(verdict, "lower_95") * scale, number(verdict, "upper_95") * scale
    kind = verdict["verdict"]
    if kind in ("interval", "determined"):
        return f"{plain(low, 3)} … {plain(high, 3)} (95 %)"
    if kind == "upper bound":
        return f"< {plain(high, 2)} (95 %)"
    if kind == "lower bound":
        return f"> {plain(low, 2)} (95 %)"
    return "not determined"
