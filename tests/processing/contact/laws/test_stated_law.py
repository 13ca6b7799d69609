"""A law stated as a function: the paper's own is fitted as the paper's, on ground and in air, too."""

import math

import numpy as np
import pytest

from processing.contact import DEFAULT_LAW, StatedLaw, StatedMoment
from processing.errors import DataError
from processing.fit import fit_exact
from tests.processing.fit.decays import decay, paper_pair

EQ3 = {"n": 0.09, "gamma_pa": 29e6}


def eq1(phi_rad, c=1e-8, b=4e-3, p=0.95):  # type: ignore[no-untyped-def]
    """Friction of the paper."""
    return c + b * phi_rad**p


def guessed(phi_rad, c=1e-8, k=0.03, m=0.9):  # type: ignore[no-untyped-def]
    """The same from a start that is ten times off: a coefficient of a power of rad is hard to guess."""
    return c + k * phi_rad**m


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "drag"), [(eq1, False), (eq1, True), (guessed, False)])
def test_the_papers_law_as_a_function_is_fitted_as_the_papers(friction: StatedMoment, drag: bool) -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=20)
    paper = fit_exact(points, pendulum, drag=drag)
    own = fit_exact(
        points, pendulum, law=StatedLaw(friction).of(points, pendulum, paper.named_values), drag=drag
    )
    near = 0.3 if drag else 0.02  # without the waveform friction and drag share a flat valley
    other_names = {"b": "k", "p": "m"} if friction is guessed else {}
    for name in DEFAULT_LAW.names(drag=drag):
        theirs, ours = paper.estimate(name), own.estimate(other_names.get(name, name))
        assert ours.value == pytest.approx(theirs.value, abs=near * theirs.standard_uncertainty)
        assert ours.standard_uncertainty == pytest.approx(theirs.standard_uncertainty, rel=near)


def test_an_elastic_moment_of_ones_own_is_that_of_a_shorter_period() -> None:
    """One in proportion to the angle is gravity's: with half a per cent of it taken, T0 is as much longer."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=20)
    like = {"period0_s": 4.07}
    periods, index = [], np.arange(5)
    for share in (0.0, 0.005):
        law = StatedLaw(eq1, lambda phi_rad, e=1e-3, share=share: (share + e) * phi_rad)
        own = np.array([1e-8, 4e-3, 0.95, 0.0, share])
        made = law.of(points, pendulum, like)
        periods.append(made.turning_points(np.array([*own, 0.0, 2e-4, 0.0, 1.5]), index).time[-1])
    # e and share are both parameters: the second is 0 in the first law
    assert periods[1] / periods[0] == pytest.approx((1 - 0.005) ** -0.5, rel=1e-5)


def fails_later(phi_rad, k=0.05):  # type: ignore[no-untyped-def]
    if k != 0.05:
        raise ValueError("k is odd")
    return k * phi_rad


@pytest.mark.parametrize(
    ("friction", "said"),
    [
        (lambda phi_rad, k: k * phi_rad, "no number where the fit begins"),
        (lambda phi_rad: phi_rad, "at least one parameter"),
        (lambda phi_rad, n=1.0: n * phi_rad, "one of Eq. 3"),
        (lambda phi_rad, k=1.0: k * phi_rad[:2], "one for each angle"),
        (lambda phi_rad, k=np.inf: k * phi_rad, "no number where the fit begins"),
        (lambda phi_rad, period0_s=1.0: phi_rad, "name it otherwise"),
        (
            lambda phi_rad, k=0.05: {}["x"],  # type: ignore[index]
            r"stated: raises KeyError \('x'\) for an array of 9 angles and k = 0.05",
        ),
        (lambda phi_rad, k=0.05: k * math.sin(phi_rad), "stated: raises TypeError .* a value for each"),
        (lambda phi_rad, k=0.05: k * phi_rad + 1j, "stated: returns complex128 for k = 0.05; one real"),
        (lambda phi_rad, k=0.05: None, "stated: returns object"),
        (fails_later, r"fails_later: raises ValueError \(k is odd\) .* and k = 0.0"),
    ],
)
def test_what_is_no_law_or_raises_is_told_with_its_name(friction: StatedMoment, said: str) -> None:
    """It passed through as it was, and imaginary parts were left out with a warning."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=100)
    with pytest.raises(DataError, match=said):
        fit_exact(points, pendulum, law=StatedLaw(friction).of(points, pendulum, {"period0_s": 4.07} | EQ3))


def overwrites(phi_rad, k=0.05):  # type: ignore[no-untyped-def]
    phi_rad *= k
    return phi_rad


def test_a_stated_law_has_angles_of_its_own() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=100)
    phi_rad = np.array([1e-4, 2e-4])
    found = [
        StatedLaw(friction)
        .of(points, pendulum, {"period0_s": 4.07} | EQ3)
        .branch_moments(phi_rad, np.ones(2), {"k": 0.05} | EQ3, pendulum)
        .friction_n_m
        for friction in (overwrites, lambda phi_rad, k=0.05: k * phi_rad)
    ]
    np.testing.assert_array_equal(found[0], found[1])
    assert phi_rad.tolist() == [1e-4, 2e-4]
