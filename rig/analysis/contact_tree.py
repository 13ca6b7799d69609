"""Evaluations and series as the plain values of results.json."""

from collections.abc import Mapping, Sequence
from typing import Any

from processing.contact import PendulumOnBall, surface_energy
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import (
    Budget,
    Combined,
    FitMethod,
    FitResult,
    Propagated,
    RigQuantities,
    average_curves,
    budgets,
    combine_runs,
    fit_asymptotic,
)
from processing.swing import TurningPoints
from rig.analysis.contact_verdicts import DRAWS, Evaluation

_HERTZ = ("radius_m", "depth_m", "angle_rad")


def estimate_tree(value: float, standard_uncertainty: float) -> dict[str, float]:
    """A value and its standard uncertainty under their fixed names."""
    return {"value": value, "standard_uncertainty": standard_uncertainty}


def evaluation_tree(evaluation: Evaluation) -> dict[str, Any]:
    """The extra keys of a run: pendulum, hertz, drag, identifiability, budget, monte_carlo, work."""
    pendulum = evaluation.pendulum
    tree: dict[str, Any] = {
        "pendulum": {
            "mass_kg": pendulum.mass_kg,
            "ball_radius_m": pendulum.ball_radius_m,
            "contact_radius_m": pendulum.contact_radius_m,
            "gravity_m_per_s2": pendulum.gravity_m_per_s2,
        },
        "hertz": {},
        "drag": {},
        "identifiability": [
            {
                "name": item.name,
                "verdict": item.verdict,
                "value": item.value,
                "standard_uncertainty": item.standard_uncertainty,
                "lower_95": item.lower,
                "upper_95": item.upper,
                "profile_likelihood": item.profiled,
                "text": item.text,
            }
            for item in evaluation.determinations
        ],
        "strong_correlations": [list(item) for item in evaluation.strong_correlations],
        "budget": {name: budget_tree(budget) for name, budget in evaluation.budgets.items()},
        "monte_carlo": _monte_carlo_tree(evaluation.propagated, evaluation.seed),
        "work_per_cycle": [
            {
                "amplitude_arcsec": work.amplitude_arcsec,
                "dissipated_4a_j": estimate_tree(*work.dissipated_j),
                "adhesive_4at_j": estimate_tree(*work.adhesive_j),
                "drag_j": work.drag_j,
            }
            for work in evaluation.work
        ],
        "notes": list(evaluation.notes),
    }
    if evaluation.contact is not None:
        contact = evaluation.contact
        tree["hertz"] = {
            name: estimate_tree(getattr(contact, name), getattr(contact, f"u_{name}")) for name in _HERTZ
        }
    if evaluation.drag is not None:
        drag = evaluation.drag
        tree["drag"] = {
            "drag_s": estimate_tree(*drag.drag_s),
            "f_statistic": drag.f_statistic,
            "p_value": drag.p_value,
            "aic_difference": drag.aic_difference,
            "relative_shift_b": drag.shift_b,
            "relative_shift_c": drag.shift_c,
            "significant": drag.significant,
            "text": drag.text,
            "with_drag": {name: estimate_tree(*e) for name, e in drag.with_drag.estimates().items()},
        }
    return tree


def budget_tree(budget: Budget) -> dict[str, Any]:
    """A GUM budget, sources with the largest contribution first."""
    return {
        "unit": budget.unit,
        **estimate_tree(budget.value, budget.standard_uncertainty),
        "degrees_of_freedom": budget.dof,
        "coverage_factor_95": budget.coverage_factor,
        "expanded_uncertainty_95": budget.expanded,
        "sources": [
            {
                "source": line.source,
                "type": line.kind,
                "u_source": line.u_source,
                "sensitivity": line.sensitivity,
                "contribution": line.contribution,
                "share": line.share,
            }
            for line in budget.lines
        ],
    }


def _monte_carlo_tree(propagated: Mapping[str, Propagated], seed: int) -> dict[str, Any]:
    if not propagated:
        return {}
    return {
        "draws": DRAWS,
        "seed": seed,
        "quantities": {
            name: {
                "mean": item.mean,
                "standard_uncertainty": item.standard_uncertainty,
                "lower_95": item.lower,
                "upper_95": item.upper,
                "gum_holds": item.gum_holds,
            }
            for name, item in propagated.items()
        },
    }


def series_tree(
    fits: Mapping[str, Sequence[FitResult]],
    points: Sequence[TurningPoints],
    pendulum: PendulumOnBall,
    rig: RigQuantities | None,
    *,
    printed_curvature: bool = False,
) -> dict[str, Any]:
    """A series of runs of one contact pair: every fit combined, and the paper's way beside it.

    Parameters
    ----------
    fits
        By method, one fit a run; a method with fewer than two is left out.
    points
        The turning points of the same runs, for the averaged curve.
    """
    tree: dict[str, Any] = {"runs": len(points)}
    problems: list[str] = []
    for method, results in fits.items():
        try:
            combined = combine_runs(results)
        except DataError as error:
            problems.append(f"{method}: {error}")
            continue
        tree[method] = {name: _combined_tree(item) for name, item in combined.parameters.items()}
        if method == FitMethod.EXACT:
            tree["surface_energy_j_per_m2"] = energy_tree(combined.parameters["c"].estimate, pendulum)
            if rig is not None:
                found = budgets(combined.measured, rig)
                tree["budget"] = {name: budget_tree(budget) for name, budget in found.items()}
            tree["disagreements"] = [
                {"run": item.run + 1, "name": item.name, "deviation": item.deviation}
                for item in combined.disagreements
            ]
    try:
        average = fit_asymptotic(average_curves(points), pendulum, printed_curvature=printed_curvature)
        tree["averaged_curves"] = {
            **{name: estimate_tree(*estimate) for name, estimate in average.estimates().items()},
            "arae_decay": average.arae_decay,
            "arae_period": average.arae_period,
        }
    except DataError as error:
        problems.append(f"averaged curves: {error}")
    tree["problems"] = problems
    return tree


def _combined_tree(item: Combined) -> dict[str, Any]:
    return {
        **estimate_tree(item.value, item.standard_uncertainty),
        "expanded_uncertainty_95": item.expanded,
        "degrees_of_freedom": item.dof,
        "within_runs": item.within,
        "between_runs": item.between,
        "p_homogeneous": item.p_homogeneous,
        "runs": [estimate_tree(*run) for run in item.runs],
    }


def energy_tree(c: Estimate, pendulum: PendulumOnBall) -> dict[str, Any]:
    """Both forms of the surface energy; each is proportional to c, and so is its uncertainty."""
    forms = surface_energy(c.value, pendulum), surface_energy(c.standard_uncertainty, pendulum)
    return {
        "table2": estimate_tree(*(form.table2_j_per_m2 for form in forms)),
        "eq2": estimate_tree(*(form.eq2_j_per_m2 for form in forms)),
    }
