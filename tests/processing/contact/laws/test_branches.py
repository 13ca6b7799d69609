"""Laws that follow from the last reversal: their map against integrations, their fits against the truth."""

import numpy as np
import pytest

from processing.contact import LAWS, PendulumOnBall
from processing.fit import compare_laws, fit_exact
from processing.swing import TurningPoints
from tests.processing.contact.gradients import assert_gradients
from tests.processing.contact.laws.branches import dahl_decay, slider_decay
from tests.processing.fit.decays import ARCSEC, decay, paper_pair, with_noise

FIRST, PERIOD_S = 124 * ARCSEC, 4.05
PENDULUM: PendulumOnBall = paper_pair("steel")[1]


def seen(amplitude_rad: np.ndarray, time_s: np.ndarray, seed: int) -> TurningPoints:
    return with_noise(time_s, amplitude_rad, PERIOD_S, 0.005, np.random.default_rng(seed))


def masing_points(k: float, q: float, c: float, count: int, seed: int) -> TurningPoints:
    """A backbone k phi^q as many springs with sliders, of which one after another slips; with noise."""
    edges = FIRST * np.concatenate([[0.0], np.geomspace(1e-5, 1.05, 1000)])
    slope = np.diff(k * edges**q) / np.diff(edges)
    stiffness = -np.diff(np.append(slope, 0.0))
    amplitude, time = slider_decay(stiffness, edges[1:] / FIRST, c / FIRST, 0.0, 1.0, count)
    return seen(amplitude * FIRST, time * PERIOD_S / (2 * np.pi), seed)


def test_dahls_half_swings_are_those_of_his_equation() -> None:
    amplitude, time = dahl_decay(0.02, 0.04, 1.0, 16)
    begun = 3  # what the first reversal remembers is not known, and has faded then
    first = float(amplitude[begun])
    found = LAWS["dahl"].turning_points(np.array([0.02, 0.04, 0.0, FIRST, 0.0, first]), np.arange(16 - begun))
    np.testing.assert_allclose(found.amplitude, amplitude[begun:], rtol=3e-7)
    np.testing.assert_allclose(found.time, (time[begun:] - time[begun]) / (2 * np.pi), rtol=1e-7)


@pytest.mark.parametrize("c", [0.0, 1e-320, -1e-3, 1e300, np.inf])
@pytest.mark.parametrize("sigma", [0.0, 0.04, 1e300])
def test_dahls_trial_parameters_beyond_all_sense_warn_of_nothing(c: float, sigma: float) -> None:
    """A search passes through them on its way; the decay then ends at once, or has no loss."""
    found = LAWS["dahl"].turning_points(np.array([c, sigma, 0.0, FIRST, 0.0, 1.0]), np.arange(5))
    assert found.amplitude.shape == (5,)


@pytest.mark.parametrize("drag", [0.0, 1e-3])
def test_sliders_lose_what_they_lose_one_by_one(drag: float) -> None:
    stiffness = np.array([0.01, 0.008, 0.01, 0.006])
    slip = np.array([4.0, 12.0, 36.0, 90.0]) * ARCSEC / FIRST
    amplitude, time = slider_decay(stiffness, slip, 1e-4, drag, 1.0, 20)
    found = LAWS["maxwell-slip"].turning_points(
        np.array([*stiffness, 1e-4, drag, FIRST, 0.0, 1.0]), np.arange(20)
    )
    # tabulated across the kinks at which a slider gives way
    np.testing.assert_allclose(found.amplitude, amplitude, rtol=2e-5)
    np.testing.assert_allclose(found.time, time / (2 * np.pi), rtol=2e-5)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("masing", [0.07, 0.9, 1e-4]),
        ("dahl", [0.02, 0.04]),
        ("maxwell-slip", [0.01, 0.008, 0.01, 0.006, 1e-4]),
        ("constant", [1e-3]),
        ("viscous", []),
    ],
)
def test_gradients_are_those_of_differences(name: str, values: list[float]) -> None:
    # the table rounds the kinks of sliders that give way, and with them the slopes
    rtol = 0.05 if name == "maxwell-slip" else 2e-3
    at = np.array([*values, 1e-3, FIRST, 0.0, 1.0])
    steps = 1e-3 * at
    steps[-3:-1] = 0.0  # the unit of angles and R/a, which no fit varies
    assert_gradients(LAWS[name], at, np.arange(0, 60, 3), steps, rtol=rtol, atol=1e-9)


@pytest.mark.slow
def test_rolling_with_memory_is_found_and_told_from_the_papers_law() -> None:
    """Springs and sliders one by one, which no law of the registry integrates."""
    truth = {"k": 0.066, "q": 0.944, "c": 1.05e-8, "period0_s": PERIOD_S}
    points = masing_points(0.066, 0.944, 1.05e-8, 200, 1)
    masing = fit_exact(points, PENDULUM, law=LAWS["masing"])
    assert 0.8 < masing.chi2_per_dof < 1.25
    for name, true in truth.items():
        value, u = masing.estimate(name)
        assert abs(value - true) < 3.5 * u
    compared = compare_laws(points, PENDULUM, [LAWS["paper"], LAWS["masing"]], like=masing)
    assert [trial.law.name for trial in compared.trials] == ["masing", "paper"]
    assert compared.trials[0].fit.values is masing.values
    assert compared.above_best(compared.trials[1]) > 100
    assert compared.describes
    assert compared.text() == "of these laws, masing describes this decay best; excluded: paper"


def test_a_law_is_charged_for_its_parameters_and_no_more() -> None:
    """Sliders beside a constant friction that they do not help to describe."""
    index = np.arange(120)
    points = seen(FIRST - 8e-7 * index, 0.5 * PERIOD_S * index, 1)
    compared = compare_laws(points, PENDULUM, [LAWS["maxwell-slip"], LAWS["constant"]])
    best, sliders = compared.trials
    assert best.law.name == "constant"
    assert 0 < compared.above_best(sliders) <= 4 * np.log(2 * len(points))


@pytest.mark.slow
def test_the_papers_law_excludes_the_others() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=80)
    compared = compare_laws(points, pendulum, LAWS.values())
    assert compared.trials[0].law.name == "paper"
    assert [trial.law.name for trial in compared.remaining] == ["paper"]
    assert {trial.law.name for trial in compared.trials} == set(LAWS)


def test_a_decay_too_short_to_tell_says_so() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=2.0, seed=1, last_arcsec=90)
    compared = compare_laws(points, pendulum, [LAWS["paper"], LAWS["masing"], LAWS["viscous"]])
    assert {trial.law.name for trial in compared.remaining} >= {"masing", "viscous"}
    assert "cannot tell" in compared.text()
