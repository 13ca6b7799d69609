"""The exact fit on ground that moves: an independent integration drives the pendulum."""

import numpy as np
import pytest

from processing.contact import turning_points_of
from processing.contact.law import PendulumOnBall
from processing.contact.laws import PAPER
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.evidence import Evidence
from processing.fit.exact import fit_exact, starts_of
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise
from processing.least_squares import Solution, solve
from processing.swing import TurningPoints
from tests.processing.fit.decays import decay, paper_pair, pulls, truth
from tests.processing.fit.driven import driven_decay

SIX = len(PAPER.names())


def one_decay(points: TurningPoints, pendulum: PendulumOnBall) -> Solution:
    """Least squares to one free decay, every turning point with an error of its own."""
    model = ExactModel(points, pendulum)
    return solve(model, next(starts_of(model)), lower=model.lower, upper=model.upper)


@pytest.mark.parametrize("seed", [1, 6, 22])
def test_a_short_run_does_not_take_its_drive_for_a_larger_scatter(seed: int) -> None:
    """By chance the scale was 1.2 and the drive too small: of 75 s 95 % held T0 in 86 of 100."""
    parameters, pendulum = paper_pair("glass_k8", 1.7e-3)
    points = driven_decay(parameters, pendulum, q=8e-9, noise_arcsec=0.0013, seed=seed, last_arcsec=86)
    known = Evidence(drag_s=Estimate(1.7e-3, 1e-5))
    result = fit_exact(points, pendulum, drag=True, evidence=known, averaged=False)
    assert result.ground.measurement_scale < 1.1
    assert abs(pulls(result, parameters, "period0_s")[0]) < 2


def test_at_rest_the_fit_is_that_of_one_free_decay() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1)
    result = fit_exact(points, pendulum)
    assert not result.ground.seen
    # at 5e-10 the drive adds a tenth to the uncertainties, at 1e-9 a half
    assert 2e-10 < result.ground.upper_95 < 3e-9
    solution = one_decay(points, pendulum)
    values, matrix = ExactModel(points, pendulum).parametrisation.physical(solution.values)
    u = np.sqrt(np.diag(matrix @ solution.covariance @ matrix.T))
    # a drive that chance suggests moves the values by less than it widens them
    assert np.all(np.abs(result.values - values) < 0.1 * u)
    assert np.all(result.standard_uncertainty > 0.999 * u)


def test_a_drive_of_nothing_leaves_one_free_decay() -> None:
    parameters, pendulum = paper_pair("steel")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1)
    rest = one_decay(points, pendulum)
    model = ExactModel(points, pendulum)
    little = 1e-4 * float(np.median(model.u_amplitude))
    ground = model.on_ground(rest.values, Noise(step=little))
    moved = solve(ground, rest.values, lower=model.lower, upper=model.upper)
    u = np.sqrt(np.diag(rest.covariance))
    assert np.all(np.abs(moved.values - rest.values) < 0.02 * u)
    np.testing.assert_allclose(np.sqrt(np.diag(moved.covariance)), u, rtol=0.01)


def test_with_a_drive_alone_the_residuals_are_errors_of_one_step() -> None:
    """Measured without noise: each amplitude and time against one half-swing from those before."""
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=3e-8, noise_arcsec=1e-7, seed=2, last_arcsec=20)
    model = ExactModel(points, pendulum)
    true = [*truth(parameters, model.names), points.amplitude[0], points.time_s[0]]
    columns = model.parametrisation.from_physical(dict(zip(model.names, true, strict=True)))
    step = 1e-9
    noise = Noise(step=step / model.reference, averaged=False)
    found = model.filtered(columns, noise).residuals.reshape(2, -1)
    rate = 2 * np.pi / (2 * np.diff(points.time_s).mean())
    for i in (0, 1, 10, 100, len(points) - 2):
        amplitude, time = turning_points_of(parameters, pendulum, float(points.amplitude[i]), 2)
        # the mean growth of a vector to which a random one is added
        drift = 0.5 * step**2 / points.amplitude[i]
        expected = -(points.amplitude[i + 1] - amplitude[1] - drift) / step
        assert found[0, i + 1] == pytest.approx(expected, rel=1e-3, abs=1e-3)
        late = points.time_s[i + 1] - points.time_s[i] - (time[1] - time[0])
        expected = -late * rate * points.amplitude[i] / step
        assert found[1, i + 1] == pytest.approx(expected, rel=5e-2, abs=5e-2)


@pytest.mark.slow
def test_on_driven_ground_the_truth_lies_within_the_uncertainties() -> None:
    """One seed each; the full count is the row coverage-ground of docs/validation.md."""
    z = []
    driven = [("glass_k8", 1e-9), ("silicon", 1e-8), ("steel", 1e-7)]
    for flat, q in driven:
        parameters, pendulum = paper_pair(flat)
        points = driven_decay(parameters, pendulum, q=q, noise_arcsec=0.005, seed=0)
        result = fit_exact(points, pendulum, averaged=False)
        z.append(pulls(result, parameters))
        assert q < 1.5 * result.ground.upper_95
        assert result.ground.seen or q < 3e-9
        if result.ground.seen:
            density, u = result.ground.density_rad_per_s2_rthz
            assert abs(density - q) < 4 * u
        assert abs(result.chi2_per_dof - 1) < 5 * np.sqrt(2 / result.dof)
        assert not result.whiteness.correlated
    # six parameters with about three independent errors: 4 u once in 500, and the rms within 4 of its u
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(np.square(z))) < 1 + 4 / np.sqrt(18)


@pytest.mark.slow
def test_eqs_5_and_6_state_the_scatter_that_the_drive_gives() -> None:
    """Four seeds: a standard deviation is known to 41 %."""
    parameters, pendulum = paper_pair("glass_k8")
    values, stated = [], []
    for seed in range(4):
        points = driven_decay(parameters, pendulum, q=3e-8, noise_arcsec=0.005, seed=seed, last_arcsec=20)
        exact = fit_exact(points, pendulum, averaged=False)
        result = fit_asymptotic(points, pendulum, exact=exact)
        values.append(result.values[:SIX])
        stated.append(result.standard_uncertainty[:SIX])
        alone = fit_asymptotic(points, pendulum).standard_uncertainty[:SIX]
        assert np.all(result.standard_uncertainty[:3] > 2 * alone[:3])
    ratio = np.std(values, axis=0, ddof=1) / np.mean(stated, axis=0)
    assert np.all((ratio > 0.4) & (ratio < 1.9))


def test_the_end_of_a_run_that_the_ground_moves_is_left_out_and_said() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=3e-6, noise_arcsec=0.005, seed=1)
    result = fit_exact(points, pendulum, averaged=False)
    assert result.ground.left_out_half_cycles > 0
    assert result.half_cycles + result.ground.left_out_half_cycles == len(points)
    weakest = points.amplitude[: result.half_cycles].min()
    assert weakest > 10 * result.ground.noise.step
    assert any(
        f"{result.ground.left_out_half_cycles} half-cycles at the end" in warning
        for warning in result.warnings
    )
    assert np.abs(pulls(result, parameters)).max() < 4


def test_a_ground_as_strong_as_the_swing_is_refused_in_one_line() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=1e-5, noise_arcsec=0.005, seed=0, first_arcsec=12)
    with pytest.raises(
        DataError, match="the ground drives the pendulum as strongly as it swings: amplitudes below"
    ) as error:
        fit_exact(points, pendulum, averaged=False)
    assert "\n" not in str(error.value)
