"""How a parameter is shown that the data may not determine: value, interval or bound."""

from collections.abc import Mapping

from processing.estimate import WELL_DETERMINED, Determinacy, Estimate
from processing.fit import Combined, Determination
from rig.presentation import interval, law_parameters, plain, quantity


def determined_text(name: str, found: Estimate, verdicts: Mapping[str, Determination]) -> str:
    """Value and uncertainty where the data determine the parameter, else its interval or bound.

    A surface energy is c times what is known of the apparatus, and shares c's verdict.
    """
    shown = quantity(name)
    is_energy = name.startswith("surface_energy")
    verdict = verdicts.get("c" if is_energy else name)
    if verdict is None or verdict.verdict is Determinacy.DETERMINED:
        return shown.text(*found)
    per_parameter = found.value / verdict.value if is_energy else 1.0
    return bound_text(verdict, shown.factor * per_parameter)


def series_verdicts(combined: Mapping[str, Combined]) -> dict[str, Determination]:
    """Verdicts on a series' parameters by their 95 % intervals."""
    found = {}
    for name, item in combined.items():
        low, high = item.value - item.expanded_uncertainty_95, item.value + item.expanded_uncertainty_95
        kind = Determinacy.DETERMINED
        if item.standard_uncertainty > WELL_DETERMINED * abs(item.value):
            kind = Determinacy.INTERVAL
            if low <= 0 and law_parameters()[name].lower == 0:
                kind = Determinacy.UPPER_BOUND
        found[name] = Determination(name=name, verdict=kind, value=item.value, lower_95=low, upper_95=high)
    return found


def bound_text(verdict: Determination, scale: float = 1.0) -> str:
    """`low … high` or a bound, 95 %."""
    low, high = verdict.lower_95 * scale, verdict.upper_95 * scale
    if verdict.verdict in (Determinacy.INTERVAL, Determinacy.DETERMINED):
        return f"{interval(low, high)} (95 %)"
    if verdict.verdict is Determinacy.UPPER_BOUND:
        return f"< {plain(high, 2)} (95 %)"
    if verdict.verdict is Determinacy.LOWER_BOUND:
        return f"> {plain(low, 2)} (95 %)"
    return "not determined"
