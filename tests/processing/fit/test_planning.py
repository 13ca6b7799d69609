"""What a planned run is said to tell, against what such runs tell."""

from dataclasses import replace

import numpy as np
import pytest

from processing.contact import LAWS
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import Conditions, fit_exact, planned_run
from processing.fit.ground import density_of_step, step_of_density
from tests.processing.fit.decays import ARCSEC, decay, paper_pair, truth
from tests.processing.fit.driven import driven_decay

NOISE_ARCSEC = 0.005
PARAMETERS, PENDULUM = paper_pair("glass_k8")
NAMES = LAWS["paper"].names()
VALUES = dict(zip(NAMES, truth(PARAMETERS, NAMES), strict=True))


def conditions(q: float = 0.0) -> Conditions:
    u_rad = NOISE_ARCSEC * ARCSEC
    return Conditions(u_rad, u_rad * 4.071 / (2 * np.pi), q)


def test_a_step_and_its_density_are_inverse() -> None:
    assert step_of_density(density_of_step(3e-9, 2.04), 2.04) == pytest.approx(3e-9)


@pytest.mark.slow
@pytest.mark.parametrize("q", [0.0, 3e-8])
def test_a_plan_says_what_runs_scatter(q: float) -> None:
    """Four runs of an equation of motion of the tests' own; their scatter is known to 41 %."""
    planned = planned_run(VALUES, PENDULUM, conditions(q), 124 * ARCSEC, 30 * ARCSEC)
    found = []
    for seed in range(4):
        if q:
            points = driven_decay(PARAMETERS, PENDULUM, q=q, noise_arcsec=NOISE_ARCSEC, seed=700 + seed)
            points = points.first(planned.half_cycles)
        else:
            points = decay(PARAMETERS, PENDULUM, noise_arcsec=NOISE_ARCSEC, seed=700 + seed, last_arcsec=30)
        assert abs(len(points) - planned.half_cycles) <= 2
        assert points.time_s[-1] - points.time_s[0] == pytest.approx(planned.duration_s, rel=0.02)
        found.append(fit_exact(points, PENDULUM, averaged=bool(not q)).values[: len(NAMES)])
    for name, scatter in zip(NAMES, np.std(found, axis=0, ddof=1), strict=True):
        assert 0.2 < scatter / planned.u[name] < 2.2, name


def test_a_higher_start_and_a_lower_end_tell_more() -> None:
    runs = [
        planned_run(VALUES, PENDULUM, conditions(), first * ARCSEC, last * ARCSEC)
        for first, last in ((124, 15), (124, 4), (300, 4))
    ]
    for name in NAMES:
        u = [run.u[name] for run in runs]
        assert u == sorted(u, reverse=True), name
    # "How long to measure": 1.6 and 0.37 % of c after 11.1 and 17.1 minutes without a drive
    for run, percent, minutes in zip(runs[:2], (1.6, 0.37), (11.1, 17.1), strict=True):
        assert 100 * run.u["c"] / VALUES["c"] == pytest.approx(percent, rel=0.06)
        assert run.duration_s / 60 == pytest.approx(minutes, rel=0.02)


def test_what_is_known_of_the_air_counts_once_however_many_runs() -> None:
    """Ten runs were promised a drag three times better known than beforehand, by that alone."""
    known = Estimate(1.7e-3, 1e-7)
    run = planned_run(
        {**VALUES, "drag_s": known.value}, PENDULUM, replace(conditions(), known_drag_s=known),
        124 * ARCSEC, 8 * ARCSEC,
    )  # fmt: skip
    ten = run.u_after(10, known)
    assert run.u["drag_s"] == pytest.approx(1e-7, rel=0.02)
    assert ten["drag_s"] == pytest.approx(1e-7, rel=0.2)
    free = run.u_after(10, None)
    assert free["drag_s"] == pytest.approx(run.u_after(1000, None)["drag_s"] * 10, rel=1e-6)


def test_a_run_in_vacuum_is_planned_as_one_in_hardly_any_air() -> None:
    drag_prior = replace(conditions(), known_drag_s=Estimate(1.7e-3, 1.2e-3))
    vacuum, thin = (
        planned_run({**VALUES, "drag_s": drag}, PENDULUM, drag_prior, 124 * ARCSEC, 4 * ARCSEC)
        for drag in (0.0, 1e-12)
    )
    assert vacuum.u == pytest.approx(thin.u, rel=1e-3)
    # the decay tells more of the drag than its prior does
    assert vacuum.u["drag_s"] < 0.5 * 1.2e-3
    after = [run.u_after(2, drag_prior.known_drag_s) for run in (vacuum, thin)]
    assert after[0] == pytest.approx(after[1], rel=1e-3)


def test_the_ground_ends_a_run() -> None:
    assert planned_run(VALUES, PENDULUM, conditions(1e-8), 124 * ARCSEC, 2 * ARCSEC).complete
    planned = planned_run(VALUES, PENDULUM, conditions(1e-5), 124 * ARCSEC, 2 * ARCSEC)
    assert not planned.complete
    assert planned.duration_s < 900
    with pytest.raises(DataError, match="half-cycles; a fit needs"):
        planned_run(VALUES, PENDULUM, conditions(), 124 * ARCSEC, 123.9 * ARCSEC)


@pytest.mark.parametrize(("noise", "left"), [(1.0, np.sqrt(0.5)), (0.1, 0.0995)])
def test_a_seismometer_leaves_of_the_ground_what_its_own_noise_hides(noise: float, left: float) -> None:
    ground = conditions(1e-7)
    amplitudes = (124 * ARCSEC, 30 * ARCSEC)
    with_seismometer = planned_run(VALUES, PENDULUM, replace(ground, seismometer_noise=noise), *amplitudes)
    assert with_seismometer.u == pytest.approx(
        planned_run(VALUES, PENDULUM, ground.on_ground(left * 1e-7), *amplitudes).u, rel=0.01
    )
    # the ground drowns a run no later for it
    assert with_seismometer.half_cycles == planned_run(VALUES, PENDULUM, ground, *amplitudes).half_cycles
