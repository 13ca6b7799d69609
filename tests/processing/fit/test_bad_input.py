"""Swings that cannot be fitted give one clear line."""

from dataclasses import replace

import numpy as np
import pytest

from processing.contact.law import PendulumOnBall
from processing.errors import DataError
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.exact import fit_exact
from processing.swing import TurningPoints
from tests.processing.fit.decays import decay, paper_pair, without


@pytest.fixture(scope="module")
def pendulum() -> PendulumOnBall:
    return paper_pair("glass_k8")[1]


@pytest.fixture(scope="module")
def points() -> TurningPoints:
    return decay(*paper_pair("glass_k8"), noise_arcsec=0.005, seed=1, last_arcsec=60)


def changed(points: TurningPoints, name: str, position: int, value: float) -> TurningPoints:
    column = getattr(points, name).copy()
    column[position] = value
    return replace(points, **{name: column})


def refused(points: TurningPoints, pendulum: PendulumOnBall, message: str) -> None:
    for fit in (fit_exact, fit_asymptotic):
        with pytest.raises(DataError, match=message) as error:
            fit(points, pendulum)
        assert "\n" not in str(error.value)


def test_too_few_and_amplitudes_that_grow_are_refused_and_ten_are_enough_to_try(
    points: TurningPoints, pendulum: PendulumOnBall
) -> None:
    few = without(points, np.arange(9, 10_000))
    refused(few, pendulum, "9 usable half-cycles, and a fit needs at least 10")
    refused(without(points, np.arange(10_000)), pendulum, "0 usable half-cycles")
    refused(replace(points, amplitude=points.amplitude[::-1]), pendulum, "does not fall")
    result = fit_exact(without(points, np.arange(10, 10_000)), pendulum)
    assert result.dof == 20 - 8
    assert np.all(result.standard_uncertainty > 0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("u_amplitude", 0.0, "u_amplitude of half-cycle 7 is 0: it must be positive"),
        ("u_time_s", -1e-3, "u_time_s of half-cycle 7 is -0.001: it must be positive"),
        ("amplitude", -1e-4, "amplitude of half-cycle 7 is -0.0001: it must be positive"),
        ("amplitude", np.nan, "amplitude of half-cycle 7 is nan: flag it or leave it out"),
        ("time_s", 1.0, "half-cycles out of order: time_s does not rise after half-cycle 6"),
        ("index", 3, "half-cycles out of order: index does not rise after half-cycle 6"),
    ],
)
def test_impossible_values(
    points: TurningPoints, pendulum: PendulumOnBall, name: str, value: float, message: str
) -> None:
    refused(changed(points, name, 7, value), pendulum, message)


def test_a_kick_is_named_in_a_warning(points: TurningPoints, pendulum: PendulumOnBall) -> None:
    amplitude = points.amplitude.copy()
    amplitude[40:] *= 1.05
    result = fit_exact(replace(points, amplitude=amplitude), pendulum)
    assert any("jumps up at half-cycle 40" in warning for warning in result.warnings)
    assert result.outliers == (40,)


def test_no_two_neighbours_leave_eq6_nothing(points: TurningPoints, pendulum: PendulumOnBall) -> None:
    lonely = without(points, points.index[1::2])
    with pytest.raises(DataError, match="full periods"):
        fit_asymptotic(lonely, pendulum)
    assert fit_exact(lonely, pendulum).chi2_per_dof < 2, "the exact map runs over the gaps"
