"""Contact or air: what the waveform and what is known of the air say beside the turning points."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from processing.contact import law_harmonics
from processing.contact.laws import LAWS
from processing.estimate import Estimate
from processing.fit import (
    Evidence,
    FitResult,
    LinearisedFit,
    compare_laws,
    drift_term,
    fit_exact,
    fit_with_knocks,
    waveform_of,
)
from processing.fit.evidence import Waveform
from processing.fit.exact_model import ExactModel
from processing.swing import ORDERS, PieceHarmonics, TurningPoints
from tests.processing.fit.decays import ARCSEC, decay, paper_pair, pulls
from tests.processing.fit.driven import World, driven_path
from tests.processing.fit.frames import points_and_harmonics, seen_decay, seen_in_frames

RATE, U, DRAG_S = 25.0, 0.005 * ARCSEC, 1.7e-3
PARAMETERS, PENDULUM = paper_pair("glass_k8", DRAG_S)
Seen = tuple[TurningPoints, PieceHarmonics]


@cache
def path_of(q: float, seed: int, last_arcsec: float) -> np.ndarray:
    """Integrated once."""
    return driven_path(PARAMETERS, PENDULUM, q=q, seed=seed, frames_per_s=RATE, last_arcsec=last_arcsec)[2]


def seen(q: float, seed: int, stated: float = 1.0, last_arcsec: float = 2.0) -> Seen:
    """A decay in air as frames show it, with uncertainties that are stated so many times too large."""
    path = path_of(q, seed, last_arcsec)
    samples = seen_in_frames(path, U, [seed, 3], RATE)
    return points_and_harmonics(replace(samples, u_y=stated * samples.u_y))


@pytest.fixture(scope="module")
def basement() -> Seen:
    return seen(8e-9, 4, last_arcsec=8.0)


@pytest.fixture(scope="module")
def fitted(basement: Seen) -> FitResult:
    points, harmonics = basement
    return fit_exact(points, PENDULUM, drag=True, evidence=Evidence(waveform_of(harmonics)))


def test_the_waveform_tells_air_from_contact_and_counts_once(basement: Seen, fitted: FitResult) -> None:
    """On moving ground, with nothing known of the air, where turning points alone leave b open."""
    points, _ = basement
    fit, once = fitted, fitted.evidence.waveform
    assert np.all(np.abs(pulls(fit, PARAMETERS)) < 3.5)
    assert fit.estimate("b").standard_uncertainty < 0.01 * PARAMETERS.b
    assert fit.estimate("drag_s").standard_uncertainty < 2e-5
    without = fit_exact(points, PENDULUM)
    b, u = without.estimate("b")
    # what is printed where nobody thinks of the air
    assert abs(b - PARAMETERS.b) > 50 * u
    # harmonics that are repeated, half as certain each, are the same evidence
    twice = Waveform(
        np.repeat(once.amplitude_rad, 2),
        np.repeat(once.sine_rad, 2, axis=0),
        np.repeat(2 * once.covariance, 2, axis=0),
        once.scatter,
    )
    again = fit_exact(points, PENDULUM, drag=True, evidence=Evidence(twice))
    for name in fit.contact_names:
        (value, u), (other, u_other) = fit.estimate(name), again.estimate(name)
        assert other == pytest.approx(value, abs=0.03 * u)
        assert u_other == pytest.approx(u, rel=0.01)


def test_the_waveform_says_the_same_where_the_ground_is_loud(basement: Seen, fitted: FitResult) -> None:
    """As after a draught: steps as long as the points' uncertainty leave the range of the law."""
    model, columns = ExactModel.of(basement[0], PENDULUM, fitted)
    noise = replace(model.noise_of(fitted), step=1e-2)
    shaken = model.on_ground(columns, noise, 1.0).linearised_at(columns)
    quiet, driven = (one.evidence_rows(columns)[1] / one.scale for one in (model, shaken))
    # n and gamma, in the last columns, hardly show in the waveform
    off, whole = (np.linalg.norm(each[:, :4], axis=0) for each in (driven - quiet, quiet))
    assert np.all(off[:3] < 0.05 * whole[:3]), off / whole


def test_uncertainties_that_are_stated_wrongly_are_those_of_the_scatter() -> None:
    right, wrong = (waveform_of(seen(0.0, 2, stated)[1]) for stated in (1.0, 2.5))
    assert right.scatter == pytest.approx(1.0, abs=0.1)
    assert wrong.scatter == pytest.approx(0.4, abs=0.1)
    size = np.sqrt(np.median(wrong.covariance[:, 0, 0]) / np.median(right.covariance[:, 0, 0]))
    # what is stated counts for ten pieces among ninety
    assert 0.9 < size < 1.4


def test_a_disturbed_piece_is_left_out_and_few_pieces_are_no_waveform(basement: Seen) -> None:
    _, harmonics = basement
    knocked = harmonics.harmonics.copy()
    knocked[10] += 1j * 50 * U
    found = waveform_of(PieceHarmonics(harmonics.amplitude, knocked, harmonics.covariance_sine))
    assert len(found.amplitude_rad) == len(harmonics) - 1
    few = (harmonics.amplitude[:7], harmonics.harmonics[:7], harmonics.covariance_sine[:7])
    assert waveform_of(PieceHarmonics(*few)) is None


def test_disturbed_pieces_that_hide_each_other_are_left_out_one_after_the_other() -> None:
    """Each bends the curve over all so much that the next one is seen only without it."""
    count, size = 60, np.linspace(0.5, 2.0, 8)
    amplitude = np.geomspace(120.0, 80.0, count)
    seen = 0.1 * amplitude[:, None] + size * np.random.default_rng(5).standard_normal((count, 8))
    for place, knock in ((3, 1e2), (30, 1e4), (50, 1e6), (57, 1e8)):
        seen[place] += knock
    found = waveform_of(PieceHarmonics(amplitude, -1j * seen, np.tile(np.diag(size**2), (count, 1, 1))))
    assert len(found.amplitude_rad) == len(found.covariance) == count - 4


def test_a_stretch_without_pieces_leaves_the_others_as_they_are() -> None:
    """As where a reflection disturbs all pieces of some amplitudes."""
    amplitude = ARCSEC * np.array([120.0, 110.0, 100.0, 9.0, 8.0, 7.0])
    covariance = np.tile(U**2 * (np.eye(4) + 0.5), (6, 1, 1))
    sine = 2 * U * np.random.default_rng(4).standard_normal((6, 4))
    parts = [Waveform(amplitude[at], sine[at], covariance[at], 1.0) for at in np.split(np.arange(6), 2)]
    both = Waveform(amplitude, sine, covariance, 1.0).reduced(sine)
    apart = np.concatenate([one.reduced(one.sine_rad) for one in parts])
    assert len(both) == len(apart)
    assert np.sum(both**2) == pytest.approx(np.sum(apart**2))


def test_what_is_known_of_the_air_enters_as_it_is_known(basement: Seen) -> None:
    """Turning points alone hardly restrain the drag: the result is what was known, with its doubt in b."""
    points, _ = basement
    known = Estimate(1.5e-3, 0.2e-3)
    fit = fit_exact(points, PENDULUM, drag=True, evidence=Evidence(drag_s=known))
    value, u = fit.estimate("drag_s")
    assert value == pytest.approx(known.value, abs=known.standard_uncertainty)
    assert u < 1.05 * known.standard_uncertainty
    b, u_b = fit.estimate("b")
    assert abs(b - PARAMETERS.b) < 3 * u_b
    assert u_b > 0.02 * PARAMETERS.b


def test_a_drag_far_above_what_is_known_is_that_of_the_data_alone() -> None:
    """As of a pendulum with a damper, where the estimate is that of a bar of its size."""
    parameters = paper_pair("glass_k8", drag_s=0.011)[0]
    points, harmonics = seen_decay(
        parameters, PENDULUM, q=0.0, seed=1, first_arcsec=386.0, last_arcsec=60.0, noise_seed=[1, 3]
    )
    by_data = waveform_of(harmonics)
    fit = fit_with_knocks(points, PENDULUM, drag=True, evidence=Evidence(by_data, Estimate(0.35e-3, 0.26e-3)))
    alone = fit_exact(points, PENDULUM, drag=True, evidence=Evidence(by_data))
    assert np.all(np.abs(pulls(fit, parameters)) < 3.5)
    assert np.all(fit.standard_uncertainty < 1.05 * alone.standard_uncertainty)
    assert "contradict" in fit.warnings[-1]
    # a law that is wrong may ask for too small a drag, which what is known then restrains
    above = Estimate(parameters.drag_s + 1e-3, 1e-4)
    held = fit_with_knocks(points, PENDULUM, drag=True, evidence=Evidence(by_data, above))
    assert held.evidence.drag_s == above


def test_no_drift_moves_nothing_where_points_scatter_more_than_stated(basement: Seen) -> None:
    """What is known of the air, four u off, counted once more for every unit of scale: b moved by 0.7 u."""
    points, harmonics = basement
    louder = replace(points, u_amplitude=points.u_amplitude / 8, u_time_s=points.u_time_s / 8)
    known = Estimate(DRAG_S + 8e-5, 2e-5)
    fit = fit_exact(louder, PENDULUM, drag=True, evidence=Evidence(waveform_of(harmonics), known))
    at = LinearisedFit.of(louder, PENDULUM, fit)
    still = at.with_terms(drift_term(at, {}))
    assert np.all(np.abs(still.values - fit.values) < 0.03 * fit.standard_uncertainty)


def test_a_law_that_is_wrong_is_fitted_where_the_waveform_says() -> None:
    """From the turning points' own start the fit ended at p = 6, with a drive of 1e-6 that explained all."""
    points, harmonics = seen_decay(
        PARAMETERS, PENDULUM, World(drag32=0.0151), q=8e-9, seed=1, steps=400, noise_seed=[1, 78]
    )
    evidence = Evidence(waveform_of(harmonics), Estimate(1.5e-3, 1.1e-3))
    fit = fit_exact(points, PENDULUM, drag=True, evidence=evidence)
    assert fit.ground.density_rad_per_s2_rthz.value < 1e-7
    assert fit.estimate("p").value < 1.2
    values = dict(zip(fit.names, fit.values.tolist(), strict=True))
    distance = evidence.residuals(fit.law, values, PENDULUM)
    assert np.sum(distance**2) < 8 * len(distance)


@pytest.mark.slow
def test_no_fit_of_another_law_ends_by_another_waveform_than_its_own() -> None:
    """The likelihood of Maxwell's slip was that of a waveform far away: 1.6e5 where its own makes 2.8e7."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.0005, seed=1, last_arcsec=60)
    alone = fit_exact(points, pendulum)
    amplitude = np.linspace(points.amplitude[0], points.amplitude[-1], 12)
    orders = [ORDERS.index(order) for order in (3, 5, 7, 9)]
    sine = -law_harmonics(alone.law, alone.named_values, pendulum, amplitude).imag[:, orders]
    covariance = np.broadcast_to(np.diag(np.full(4, 2e-10) ** 2), (12, 4, 4)).copy()
    evidence = Evidence(Waveform(amplitude, sine, covariance, 1.0))
    fit = fit_exact(points, pendulum, evidence=evidence)
    laws = [LAWS[name] for name in ("paper", "maxwell-slip")]
    compared = compare_laws(points, pendulum, laws, like=fit)
    assert [trial.law.name for trial in compared.remaining] == ["paper"]
    for trial in compared.trials:
        if trial.fit is None:
            assert trial.problem.startswith("the fit to turning points and waveform together did not")
            continue
        left = evidence.residuals(trial.law, trial.fit.named_values, pendulum)
        # ln of the determinants of the noise is that of the same points
        of_points = trial.fit.ground.unrestricted - float(left @ left)
        assert abs(of_points) < 10_000


@pytest.mark.parametrize("louder", [1.0, 8.0])
def test_what_is_fitted_to_a_few_pieces_is_as_uncertain_as_it_scatters(louder: float) -> None:
    """In air they scatter by many times what the samples state, which 15 show, weighing themselves."""
    count, orders, size = 15, 8, np.linspace(0.5, 2.0, 8)
    rng = np.random.default_rng(5)
    amplitude = np.geomspace(120.0, 80.0, count)
    stated = np.tile(np.diag(size**2), (count, 1, 1))
    pulls = []
    for _ in range(150):
        noise = louder * size * rng.standard_normal((count, orders))
        found = waveform_of(PieceHarmonics(amplitude, -1j * (0.1 * amplitude[:, None] + noise), stated))
        pattern = np.repeat(amplitude[:, None], 4, axis=1)
        weights = np.linalg.solve(found.covariance, pattern[:, :, None])[:, :, 0]
        certainty = float(np.sum(weights * pattern))
        pulls.append((np.sum(weights * found.sine_rad) / certainty - 0.1) * np.sqrt(certainty))
    assert np.std(pulls) == pytest.approx(1.0, abs=0.15)


def test_a_drive_by_chance_costs_a_law_no_likelihood() -> None:
    """In a minute on ground at rest, a drive that the restricted likelihood prefers takes 9 off its law's."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=6, last_arcsec=104.0)
    compared = compare_laws(points, pendulum, [LAWS["paper"], LAWS["masing"]])
    best, other = compared.trials
    assert best.law.name == "paper"
    assert not best.fit.ground.noise.at_rest
    assert compared.above_best(other) > 10.0


def test_the_waveform_has_a_slope_at_the_end_of_a_parameters_range(basement: Seen) -> None:
    """Beyond p = 6 the law has no value: the search may end there, and is linearised there."""
    points, harmonics = basement
    model = ExactModel(points, PENDULUM, drag=True, evidence=Evidence(waveform_of(harmonics)))
    truth = {name: getattr(PARAMETERS, name) for name in ("b", "c", "n", "period0_s", "gamma_pa", "drag_s")}
    truth |= {"initial_amplitude_rad": points.amplitude[0], "start_time_s": 0.0}
    slopes = []
    for before_the_end in (1e-10, 0.01):
        at = {**truth, "b": 1e-7 * model.reference**-5.0, "p": 6.0 - before_the_end}
        columns = model.parametrisation.from_physical(at)
        rows, slope = model.linearised_at(columns).evidence_rows(columns)
        assert np.isfinite(rows).all()
        slopes.append(slope)
    size = np.abs(slopes[1]).max(axis=0)
    assert size.any()
    assert np.all(np.abs(slopes[0] - slopes[1]) <= 0.1 * size)
