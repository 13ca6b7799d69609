"""The likelihood of a run to come is that which a fit of it will have."""

from dataclasses import asdict

import numpy as np
import pytest

from processing.angle import ARCSEC_RAD
from processing.estimate import Estimate
from processing.fit import Conditions, drifts_of, fit_exact, planned_likelihood, planned_run
from processing.fit.planning import prepare_run
from tests.processing.fit.decays import paper_pair

NAMES = ("b", "p", "c", "n", "period0_s", "gamma_pa")
FIRST, LAST = 124 * ARCSEC_RAD, 4 * ARCSEC_RAD
U_RAD = 0.01 * ARCSEC_RAD


def values(drag_s: float) -> dict[str, float]:
    parameters = asdict(paper_pair("glass_k8", drag_s)[0])
    return {name: float(parameters[name]) for name in NAMES} | ({"drag_s": drag_s} if drag_s else {})


def test_its_widths_are_those_of_the_plan_with_the_air_taken_apart() -> None:
    pendulum = paper_pair("glass_k8", 1.7e-3)[1]
    known = Estimate(1.7e-3, 2e-5)
    conditions = Conditions(U_RAD, U_RAD, 1e-9, known_drag_s=known)
    found = planned_likelihood(values(1.7e-3), pendulum, conditions, FIRST, LAST)
    u = planned_run(values(1.7e-3), pendulum, conditions, FIRST, LAST).u
    assert found.by_air is not None
    whole = np.sqrt(np.diag(found.covariance + np.outer(found.by_air, found.by_air)))
    np.testing.assert_allclose(whole, [u[name] for name in found.names], rtol=1e-6)
    # of the drag itself nearly all is what is known beside the run
    drag = found.names.index("drag_s")
    assert abs(found.by_air[drag]) == pytest.approx(2e-5, rel=0.05)


def test_growing_friction_moves_it_as_it_moves_a_fit() -> None:
    pendulum = paper_pair("glass_k8")[1]
    conditions = Conditions(U_RAD, U_RAD)
    found = planned_likelihood(values(0.0), pendulum, conditions, FIRST, LAST)
    assert found.by_air is None
    points = prepare_run(values(0.0), pendulum, conditions, FIRST, LAST).model.points
    moved = drifts_of(points, pendulum, fit_exact(points, pendulum)).by_ageing
    size = np.array([abs(values(0.0)[name]) for name in found.names])
    np.testing.assert_allclose(found.by_growth / size, moved / size, rtol=0.1, atol=0.02)
