"""Examples 9.2 to 9.5 of GUM Supplement 1 (JCGM 101:2008) through the program's budget and Monte Carlo.

Draws are `InputQuantity.draw`, the sample is judged by `propagated`, and both against what is published or,
for 9.4, against the exact distribution (a scaled non-central chi-square) by scipy. The answers of 9.2 follow
from the distributions, too: 3.920 of four normal ones, 3.879 of four rectangles, 17.01 by other draws of
9.2.4. The inputs of 9.5 have been compared with an example of suncal (Sandia National Laboratories): those of
temperatures and expansions are the same; those of lengths are rounded, as the supplement has them. What is
published for 9.3 and 9.5 has been compared with no second source.
"""

from collections.abc import Callable, Mapping
from functools import cache
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.stats import ncx2

from processing.arrays import Floats
from processing.fit.apparatus import InputQuantity
from processing.fit.uncertainty import Budget, Propagated, propagated
from tests.validation.outside.gum import budget_by
from tests.validation.outside.printed import tolerances_off
from tests.validation.row import Found

DRAWS = 1_000_000


class Published(NamedTuple):
    """Answer of the Monte Carlo method, and whether the GUM's is said to be validated by it."""

    u: float
    low: float
    high: float
    mean: float
    validated: bool


class Case(NamedTuple):
    inputs: Mapping[str, InputQuantity]
    model: Callable[[Mapping[str, Floats]], Floats]
    published: Published


def _sum(x: Mapping[str, Floats]) -> Floats:
    return np.asarray(sum(x.values()))


def _four(quantity: InputQuantity, last: InputQuantity) -> dict[str, InputQuantity]:
    return {"X1": quantity, "X2": quantity, "X3": quantity, "X4": last}


def _mass(x: Mapping[str, Floats]) -> Floats:
    """Eq. (36) of the supplement less the nominal mass, mg."""
    buoyancy = (x["rho_a"] - 1.2) * (1 / x["rho_w"] - 1 / x["rho_r"])
    return (x["m_rc"] + x["dm_rc"]) * (1 + buoyancy) - 100_000.0


def _between(low: float, high: float) -> InputQuantity:
    return InputQuantity((low + high) / 2, (high - low) / sqrt(12), "rectangular")


def _loss(x1: float, *, validated: bool) -> Case:
    """9.4: Y = X1² + X2², in units of 1e-6; exactly, by the non-central chi-square distribution."""
    u = 0.005
    exact = ncx2(2, (x1 / u) ** 2) if x1 else ncx2(2, 1e-12)
    low, high = (float(u**2 * exact.ppf(p) * 1e6) for p in (0.025, 0.975))
    of_exact = Published(
        float(u**2 * exact.std() * 1e6), low, high, float(u**2 * exact.mean() * 1e6), validated
    )
    inputs = {"X1": InputQuantity(x1, u), "X2": InputQuantity(0.0, u)}
    return Case(inputs, lambda x: (x["X1"] ** 2 + x["X2"] ** 2) * 1e6, of_exact)


def cases() -> dict[str, Case]:
    """By the number of the clause."""
    normal = InputQuantity(0.0, 1.0)
    even = InputQuantity(0.0, 1.0, "rectangular")
    return {
        "9.2.2": Case(_four(normal, normal), _sum, Published(2.0, -3.92, 3.92, 0.0, True)),
        "9.2.3": Case(_four(even, even), _sum, Published(2.0, -3.88, 3.88, 0.0, True)),
        "9.2.4": Case(
            _four(even, InputQuantity(0.0, 10.0, "rectangular")),
            _sum,
            Published(10.1, -17.0, 17.0, 0.0, False),
        ),
        "9.3": Case(
            {
                "m_rc": InputQuantity(100_000.0, 0.050),
                "dm_rc": InputQuantity(1.234, 0.020),
                "rho_a": _between(1.10, 1.30),
                "rho_w": _between(7_000.0, 9_000.0),
                "rho_r": _between(7_950.0, 8_050.0),
            },
            _mass,
            Published(0.0754, 1.0834, 1.3825, 1.2341, False),
        ),
        "9.4, x1 = 0": _loss(0.0, validated=False),
        "9.4, x1 = 0.010": _loss(0.010, validated=False),
        "9.4, x1 = 0.050": _loss(0.050, validated=False),
    }


@cache
def _judged(name: str) -> tuple[Budget, Propagated]:
    case = cases()[name]
    budget = budget_by(case.model, case.inputs)
    rng = np.random.default_rng(101)
    drawn = {key: quantity.draw(rng, DRAWS) for key, quantity in case.inputs.items()}
    return budget, propagated(case.model(drawn), budget)


def _off(*clauses: str) -> dict[str, Found]:
    off: dict[str, float] = {}
    for clause in clauses:
        published = cases()[clause].published
        _, found = _judged(clause)
        for what, value, wanted in (
            ("mean", found.mean, published.mean),
            ("u", found.standard_uncertainty, published.u),
            ("lower end", found.lower_95, published.low),
            ("upper end", found.upper_95, published.high),
        ):
            off[f"{clause}: {what}"] = tolerances_off(value, wanted, published.u)
    worst = max(off, key=lambda name: off[name])
    return {"off": Found((off[worst],), f"{len(off)} numbers, {DRAWS:,} draws; the farthest, {worst}")}


def additive() -> dict[str, Found]:
    return _off("9.2.2", "9.2.3", "9.2.4")


def mass() -> dict[str, Found]:
    """9.3; printed is the shortest interval, whose place scatters by tolerances: its width is compared."""
    published = cases()["9.3"].published
    _, found = _judged("9.3")
    off = {
        "mean": tolerances_off(found.mean, published.mean, published.u),
        "u": tolerances_off(found.standard_uncertainty, published.u, published.u),
        "width": tolerances_off(found.upper_95 - found.lower_95, published.high - published.low, published.u),
    }
    worst = max(off, key=lambda name: off[name])
    return {"off": Found((off[worst],), f"{len(off)} numbers, {DRAWS:,} draws; the farthest, {worst}")}


def comparison_loss() -> dict[str, Found]:
    return _off("9.4, x1 = 0", "9.4, x1 = 0.010", "9.4, x1 = 0.050")


def gauge_block() -> dict[str, Found]:
    """9.5, in nm: standard uncertainties by budget and by draws.

    Published are 32 and 36. Of two inputs the standard's shapes (arcsine, curvilinear trapezoid) are no
    shapes of the program: rectangles of the same standard uncertainty stand for them, which leaves u as it
    is.
    """

    def trapezoid(half: float, inexact: float) -> InputQuantity:
        return InputQuantity(0.0, sqrt(half**2 / 3 + inexact**2 / 9), "rectangular")

    inputs = {
        "L_s": InputQuantity(50_000_623.0, 25.0, dof=18),
        "D": InputQuantity(215.0, 6.0, dof=24),
        "d1": InputQuantity(0.0, 4.0, dof=5),
        "d2": InputQuantity(0.0, 7.0, dof=8),
        "alpha": _between(9.5e-6, 13.5e-6),
        "theta": InputQuantity(-0.1, 0.2),
        "delta": InputQuantity(0.0, 0.5 / sqrt(2), "rectangular"),
        "d_alpha": trapezoid(1e-6, 0.1e-6),
        "d_theta": trapezoid(0.050, 0.025),
    }

    def model(x: Mapping[str, Floats]) -> Floats:
        heat = x["d_alpha"] * (x["theta"] + x["delta"]) + x["alpha"] * x["d_theta"]
        return x["L_s"] * (1 - heat) + x["D"] + x["d1"] + x["d2"] - 50_000_000.0

    budget = budget_by(model, inputs)
    rng = np.random.default_rng(101)
    found = propagated(model({name: quantity.draw(rng, DRAWS) for name, quantity in inputs.items()}), budget)
    off = {
        "value": abs(budget.value - 838.0) / 0.5,
        "u by budget": tolerances_off(budget.standard_uncertainty, 32.0, 32.0),
        "mean of the draws": abs(found.mean - 838.0) / 0.5,
        "u by draws": tolerances_off(found.standard_uncertainty, 36.0, 36.0),
    }
    worst = max(off, key=lambda name: off[name])
    detail = f"u {budget.standard_uncertainty:.1f} and {found.standard_uncertainty:.1f} nm; farthest, {worst}"
    return {"off": Found((off[worst],), detail)}


def verdicts() -> dict[str, Found]:
    """How many of the standard's verdicts on the GUM's interval are the program's, too."""
    wrong = [
        name for name, case in cases().items() if _judged(name)[1].gum_holds is not case.published.validated
    ]
    said = "the program calls the GUM's interval good in " + ", ".join(wrong) if wrong else ""
    return {"agree": Found((float(len(cases()) - len(wrong)),), said)}
