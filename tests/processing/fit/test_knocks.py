"""A decay that was knocked: it begins anew after each knock, and ends with a step of the rest position."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from processing.estimate import Estimate
from processing.fit import (
    ChangeKind,
    Evidence,
    FitResult,
    fit_exact,
    fit_with_knocks,
    up_to_rest_step,
)
from processing.swing import HalfCycle, HalfCycleFlag, TurningPoints
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import World, changing_decay
from tests.processing.swing.truth import half_cycle

DRAG_S = 1.7e-3
PARAMETERS, PENDULUM = paper_pair("glass_k8", DRAG_S)
KNOWN = Evidence(drag_s=Estimate(DRAG_S, 2e-5))


@cache
def decay(knock_arcsec: float) -> TurningPoints:
    """Of a world that is knocked 300 s after the first turning point."""
    rate_rad_per_s = 2 * np.pi / PARAMETERS.period0_s
    world = World(event_s=300.0, knock_rad_per_s=knock_arcsec * ARCSEC * rate_rad_per_s)
    return changing_decay(PARAMETERS, PENDULUM, world, q=1e-9, seed=1)


def fitted(points: TurningPoints, near: FitResult | None = None) -> FitResult:
    return fit_with_knocks(points, PENDULUM, drag=True, evidence=KNOWN, near=near)


@cache
def undisturbed() -> FitResult:
    return fitted(decay(0.0))


@pytest.mark.parametrize("knock_arcsec", [0.1, 2.0])
def test_a_knock_costs_no_more_than_its_half_swing(knock_arcsec: float) -> None:
    """Taken for a drive that acts all the time, it makes uncertainties 20 to 500 times larger."""
    points, quiet = decay(knock_arcsec), undisturbed()
    assert quiet.changes == ()
    found = fitted(points)
    # of the larger one it is known, and takes long
    as_drive = found if knock_arcsec > 1 else fit_exact(points, PENDULUM, drag=True, evidence=KNOWN)
    for name in ("b", "p", "c", "n", "period0_s", "gamma_pa"):
        value, u = found.estimate(name)
        assert abs(value - getattr(PARAMETERS, name)) < 3.5 * u, name
        assert u < 1.5 * quiet.estimate(name).standard_uncertainty, name
        assert as_drive is found or u < as_drive.estimate(name).standard_uncertainty / 1.5, name
    (knock,) = found.changes
    assert knock.kind is ChangeKind.KNOCK
    assert knock.time_s == pytest.approx(300.0, abs=4.1)
    amplitude = points.amplitude[np.searchsorted(points.index, knock.half_cycle)]
    assert knock.size * amplitude / ARCSEC == pytest.approx(knock_arcsec, rel=0.15, abs=0.02)
    # that of the turning point, beside which the drive is small
    assert knock.u_size * amplitude / ARCSEC == pytest.approx(0.005, rel=0.1)
    assert "the fit begins anew after it" in found.warnings[-1]
    again = fitted(points, near=found)
    assert again.changes[0].half_cycle == knock.half_cycle
    assert again.estimate("c").value == pytest.approx(
        found.estimate("c").value, abs=0.05 * found.estimate("c").standard_uncertainty
    )
    # as of a second measurement, which the shaking of the spot hardly disturbs
    assert fitted(decay(0.0), near=found).changes == ()


def test_one_wrong_turning_point_is_no_knock() -> None:
    points = decay(0.0)
    amplitude = points.amplitude.copy()
    amplitude[120] += 20 * points.u_amplitude[120]
    found = fitted(replace(points, amplitude=amplitude))
    assert found.outliers
    assert found.changes == ()


@pytest.mark.parametrize(("more", "found"), [(-0.1, 0), (0.1, 1)])
def test_a_knock_counts_by_its_gain_beyond_that_of_choosing(
    monkeypatch: pytest.MonkeyPatch, more: float, found: int
) -> None:
    """A gain of 20, and of twice the logarithm of the half-cycles among which it was chosen."""
    points = decay(0.0)
    limit = 20.0 + 2.0 * np.log(len(points))
    fit = fit_exact(points, PENDULUM, drag=True, evidence=KNOWN)

    def stand_in(*_: object, evidence: Evidence, **__: object) -> FitResult:
        gain = (limit + more) * bool(evidence.knocks)
        ground = replace(fit.ground, deviance=fit.ground.deviance - gain)
        return replace(fit, ground=ground, outliers=(120,), evidence=evidence)

    monkeypatch.setattr("processing.fit.changes.fit_exact", stand_in)
    assert len(fitted(points).changes) == found


def decay_with_knock(centre_arcsec: float, knock: int) -> list[HalfCycle]:
    """Of 60 half-cycles of 30 arcsec, those from `knock` on about another centre."""
    return [
        half_cycle(index, amplitude=30.0 * ARCSEC, centre=centre_arcsec * (index >= knock) * ARCSEC)
        for index in range(60)
    ]


@pytest.mark.parametrize("dated", [20, 23])
def test_a_knock_that_moves_the_rest_position_ends_the_fit(dated: int) -> None:
    """Across a step of 2 arcsec at 28, c lay 6.5 u off in frames of a base that tilted.

    Where disturbed half-cycles hid its own, those after it were taken for those before it.
    """
    found, line = up_to_rest_step(decay_with_knock(2.0, 20), [dated])
    assert [h.flags for h in found] == 20 * [0] + 40 * [int(HalfCycleFlag.REST_MOVED)]
    assert "at half-cycle 20 a knock moved the rest position by 6.7 % of the last amplitude" in line


def test_a_knock_before_ten_half_cycles_leaves_out_those_before_it() -> None:
    """A decay of 60 half-cycles of which 9 stood before a knock had no fit at all."""
    flag = int(HalfCycleFlag.REST_MOVED)
    found, line = up_to_rest_step(decay_with_knock(1.0, 9), [9])
    assert [h.flags for h in found] == 9 * [flag] + 51 * [0]
    assert "before it are left out" in line
    # with ten, no more behind it, or a large step, those before it are the decay
    for half_cycles, knock in (
        (decay_with_knock(1.0, 10), 10),
        (decay_with_knock(1.0, 9)[:17], 9),
        (decay_with_knock(2.0, 9), 9),
    ):
        found, line = up_to_rest_step(half_cycles, [knock])
        assert [h.flags for h in found] == knock * [0] + (len(half_cycles) - knock) * [flag]
        assert "from there on are left out" in line
    # a later knock counts among those that are left
    again = [replace(h, centre=h.centre + 2 * ARCSEC * (h.index >= 40)) for h in decay_with_knock(1.0, 9)]
    found, _ = up_to_rest_step(again, [9, 40])
    assert [h.flags for h in found] == 9 * [flag] + 31 * [0] + 20 * [flag]


def test_a_knock_about_the_same_rest_position_leaves_out_nothing() -> None:
    half_cycles = decay_with_knock(0.2, 20)
    assert up_to_rest_step(half_cycles, [20]) == (half_cycles, "")
    # no knock is dated so late
    assert up_to_rest_step(decay_with_knock(2.0, 20), [24])[1] == ""
    assert up_to_rest_step(decay_with_knock(2.0, 20), []) == (decay_with_knock(2.0, 20), "")
    # a position that wanders by as much as it seems to step
    wandering = [replace(h, centre=h.centre + (h.index % 3 - 1) * ARCSEC) for h in decay_with_knock(0.9, 20)]
    assert up_to_rest_step(wandering, [20]) == (wandering, "")
