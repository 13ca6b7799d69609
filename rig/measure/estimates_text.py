"""What a run has told of the contact so far, as rows of the screen and as values for programs."""

from collections.abc import Mapping, Sequence

from processing.estimate import Estimate
from rig.instrument import Snapshot
from rig.presentation import quantity
from rig.settings import StopCondition

_SHOWN_FROM = 1.0
"""Relative uncertainty below which a value means something."""


def estimate_rows(snapshot: Snapshot, stop_when: Sequence[StopCondition]) -> list[tuple[str, str]]:
    """Two parameters a row, and what the end of the run waits for; no row before the first fit."""
    found = snapshot.estimates
    rows = [
        (
            ", ".join(quantity(key).symbol for key in pair),
            ",  ".join(_text(key, found[key]) for key in pair),
        )
        for pair in _pairs(list(found))
    ]
    if stop_when:
        rows.append(("ends when", ", ".join(condition.text(found) for condition in stop_when)))
    return rows


def estimates_tree(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, float]]:
    """As results.json has parameters."""
    return {
        key: {"value": one.value, "standard_uncertainty": one.standard_uncertainty}
        for key, one in estimates.items()
    }


def _pairs(keys: list[str]) -> list[list[str]]:
    return [keys[first : first + 2] for first in range(0, len(keys), 2)]


def estimate_texts(key: str, one: Estimate) -> tuple[str, str]:
    """Value with its uncertainty in the parameter's shown unit, and how large the uncertainty is beside it.

    A value that its uncertainty hides is not shown.
    """
    relative = one.standard_uncertainty / abs(one.value) if one.value else float("inf")
    if not relative < _SHOWN_FROM:
        return "not yet seen", ""
    return quantity(key).text(one.value, one.standard_uncertainty), f"{100 * relative:.2g} %"


def _text(key: str, one: Estimate) -> str:
    value, relative = estimate_texts(key, one)
    return f"{value} {quantity(key).unit}".rstrip() + f" ({relative})" if relative else value
