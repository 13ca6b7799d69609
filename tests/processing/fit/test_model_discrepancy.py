"""What a law does not describe: its distance from a decay is in the uncertainties, changes are named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from processing.contact.laws import PAPER
from processing.errors import DataError
from processing.estimate import WELL_DETERMINED, Estimate
from processing.fit import (
    DISCREPANCY,
    Change,
    ChangeKind,
    Evidence,
    FitResult,
    LinearisedFit,
    compare_laws,
    drift_effects,
    drift_term,
    fit_asymptotic,
    fit_exact,
    with_changes,
    with_discrepancy,
)
from processing.series import combine_runs
from processing.swing import TurningPoints
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import World, changing_decay

DRAG_S, Q = 1.7e-3, 1e-9
PARAMETERS, PENDULUM = paper_pair("glass_k8", DRAG_S)
KNOWN = Evidence(drag_s=Estimate(DRAG_S, 2e-5))
"""As the waveform says it, which takes frames: here the turning points alone are fitted."""


@cache
def decay(world: World, seed: int = 1, q: float = Q) -> TurningPoints:
    return changing_decay(PARAMETERS, PENDULUM, world, q=q, seed=seed)


@cache
def fitted(world: World, seed: int = 1, q: float = Q) -> FitResult:
    return fit_exact(decay(world, seed, q), PENDULUM, drag=True, evidence=KNOWN)


OTHER_AIR = World(drag32=0.0151)
"""Its drag goes with the 3/2 power of the velocity."""


def near(world: World, seed: int = 1, q: float = Q) -> LinearisedFit:
    return LinearisedFit.of(decay(world, seed, q), PENDULUM, fitted(world, seed, q))


@cache
def described(world: World, seed: int = 1, q: float = Q) -> FitResult:
    return with_discrepancy(near(world, seed, q))


@pytest.mark.slow
@pytest.mark.parametrize(
    "world",
    [OTHER_AIR, World(b2=0.1 * PARAMETERS.b * (30 * ARCSEC) ** (PARAMETERS.p - 0.5), p2=0.5)],
    ids=["air with the 3/2 power of the velocity", "a second power of the angle"],
)
def test_a_law_that_does_not_describe_costs_uncertainty(world: World) -> None:
    fit, wider = fitted(world), described(world)
    assert wider.discrepancy.seen
    b, u = wider.estimate("b")
    assert b == fit.estimate("b").value
    assert abs(b - PARAMETERS.b) > 5 * fit.estimate("b").standard_uncertainty
    assert abs(b - PARAMETERS.b) < 3 * u or u > WELL_DETERMINED * b
    assert any("does not describe" in warning for warning in wider.warnings)
    # the profile, which bounds and intervals come from, knows it, too
    at = wider.names.index("b")
    assert wider.u_inflation[at] / fit.u_inflation[at] == pytest.approx(u / fit.standard_uncertainty[at])


def test_a_true_law_costs_nothing() -> None:
    """On ground at rest and on one that moves."""
    for seed, q in ((1, 0.0), (2, 8e-9)):
        same = described(World(), seed, q)
        assert not same.discrepancy.seen
        assert not replace(same.discrepancy, against_law=9.9).seen
        assert replace(same.discrepancy, against_law=10.1).seen
        assert np.array_equal(same.covariance, fitted(World(), seed, q).covariance)
        assert with_changes(near(World(), seed, q), 0.0).changes == ()


@pytest.mark.slow
def test_what_a_law_lacks_is_a_term_of_every_fit_of_it() -> None:
    """In the mean of runs, in the budget, and in another fit to the same points."""
    points, wide = decay(OTHER_AIR), described(OTHER_AIR)
    both = combine_runs([wide, wide]).parameters["b"]
    assert both.standard_uncertainty > 0.95 * wide.estimate("b").standard_uncertainty
    assert DISCREPANCY in wide.terms
    assert wide.covariance_by(DISCREPANCY)[0, 0] > 0.0
    for one in (fitted(OTHER_AIR), wide):
        assert not compare_laws(points, PENDULUM, [PAPER], like=one).describes
    other = fit_asymptotic(points, PENDULUM, drag=True, exact=wide)
    wider = other.with_terms_of(wide, DISCREPANCY)
    at = PAPER.names().index("c")
    added = wider.covariance[at, at] - other.covariance[at, at]
    assert added == pytest.approx(wide.covariance_by(DISCREPANCY)[at, at])
    with pytest.raises(DataError):
        LinearisedFit.of(points, PENDULUM, other)
    # a smooth error of the law is no slip
    assert with_changes(near(OTHER_AIR), 0.0, wide.discrepancy.against_law).changes == ()


def test_a_slip_is_found_and_dated() -> None:
    slipped = World(event_s=300.0, slip=0.05)
    found = with_changes(near(slipped), 0.0, described(slipped).discrepancy.against_law).changes
    assert [change.kind for change in found] == [ChangeKind.FRICTION]
    assert found[0].time_s == pytest.approx(300.0, abs=15.0)
    assert found[0].size == pytest.approx(0.05, abs=0.006)
    assert "friction changes by +" in found[0].text


def test_a_change_is_told_to_the_place_of_its_uncertainty() -> None:
    """12.34 +- 0.05 % was "12 ± 0.05 %": seven of its u off."""
    change = Change(kind=ChangeKind.FRICTION, half_cycle=7, time_s=30.0, size=0.1234, u_size=5e-4, gain=50.0)
    assert "friction changes by +12.340 ± 0.050 %" in change.text
    knock = replace(change, kind=ChangeKind.KNOCK, size=1.2, u_size=0.05)
    assert "moves the swing by 120.0 ± 5.0 % of" in knock.text


def test_a_step_that_is_not_found_is_in_the_uncertainties() -> None:
    """Of half a per cent, on the ground of a basement: c lay 2 to 3 u off and nothing said so."""
    found = []
    for world in (World(), World(event_s=370.0, slip=0.005)):
        fit = with_changes(near(world, 2, 8e-9), 0.01)
        assert fit.changes == ()
        (c, u), u_before = fit.estimate("c"), fitted(world, 2, 8e-9).estimate("c").standard_uncertainty
        found.append((c, u, u / u_before))
    (still, _, wider_still), (moved, u, wider) = found
    assert wider_still < 1.1
    assert wider > 1.5
    assert abs(moved - still) < 1.5 * u


def test_what_drifts_do_to_the_parameters() -> None:
    """Against decays that drift; the difference of two, so that noise and ground are the same.

    Of a contact that ages as a whole c would hardly move; of b alone it moved by 3 u without a word.
    """
    lasting_s, still = float(decay(World(), 1, 0.0).time_s[-1]), fitted(World(), 1, 0.0)
    drifts = drift_effects(near(World(), 1, 0.0))
    for world, by, names in (
        (World(ageing=0.005, lasting_s=lasting_s), 0.005 * drifts["ageing"], ("b", "p", "c")),
        (World(drag_drift=0.005, lasting_s=lasting_s), 0.005 * drifts["drag_drift"], ("b", "p", "c")),
        (World(slower=1e-5, lasting_s=lasting_s), 1e-5 * drifts["period_drift"], ("gamma_pa", "period0_s")),
    ):
        moved = fitted(world, 1, 0.0)
        for name in names:
            at = still.names.index(name)
            assert moved.values[at] - still.values[at] == pytest.approx(by[at], rel=0.15)


def test_drifts_can_be_fitted_about_zero() -> None:
    aged = World(ageing=0.01, lasting_s=740.0)
    fit, linear = fitted(aged, 1, 0.0), near(aged, 1, 0.0)
    free = linear.with_terms(drift_term(linear, {"ageing": 0.01, "period_drift": 1e-5}))
    at = fit.names.index("p")
    p, u = free.estimate("p")
    assert abs(fit.values[at] - PARAMETERS.p) > 3 * fit.standard_uncertainty[at]
    assert abs(p - PARAMETERS.p) < 2 * u
    by = drift_effects(linear)["ageing"][at]
    # the turning points say nothing of it: what is believed remains
    assert u == pytest.approx(np.hypot(fit.standard_uncertainty[at], 0.01 * by), rel=0.2)
    none = linear.with_terms(drift_term(linear, {}))
    assert none.values == pytest.approx(fit.values, rel=1e-4)
    assert none.standard_uncertainty == pytest.approx(fit.standard_uncertainty, rel=1e-3)
