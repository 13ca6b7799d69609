"""Turning times that alternate, by a rolling shutter or about another middle: seen, named and taken off."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from processing.contact.laws import PAPER
from processing.estimate import Estimate
from processing.fit import (
    REST_POSITION,
    LinearisedFit,
    fit_exact,
    row_delay,
    time_alternation,
    with_rest_position,
    without_alternation,
)
from tests.processing.fit.decays import ARCSEC, paper_pair, truth
from tests.processing.fit.driven import driven_decay, driven_path
from tests.processing.fit.frames import points_and_harmonics, seen_decay, seen_in_frames

PARAMETERS, PENDULUM = paper_pair("glass_k8")
DELAY_S_PER_RAD = 12.5
"""30 us a row where the tilt of one row is 2.4e-6 rad: a sensor of 4.8 um at an arm of 1 m."""


@pytest.mark.slow
def test_alternating_times_are_those_of_a_shutter() -> None:
    points = driven_decay(PARAMETERS, PENDULUM, q=1e-8, noise_arcsec=0.005, seed=5)
    at_once = fit_exact(points, PENDULUM, averaged=False)
    alone = time_alternation(LinearisedFit.of(points, PENDULUM, at_once))
    assert not alone.taken_off_texts
    assert without_alternation(points, alone).time_s.tolist() == points.time_s.tolist()
    late = DELAY_S_PER_RAD * points.amplitude * (1 - 2 * (points.index % 2))
    seen = replace(points, time_s=points.time_s + late)
    fit = fit_exact(seen, PENDULUM, averaged=False)
    found = time_alternation(LinearisedFit.of(seen, PENDULUM, fit))
    assert found.rows.delay_s_per_rad == pytest.approx(DELAY_S_PER_RAD, rel=0.01)
    (text,) = found.taken_off_texts
    assert "rolling shutter" in text
    mended = fit_exact(without_alternation(seen, found), PENDULUM, averaged=False)
    apart = (mended.values - at_once.values) / at_once.standard_uncertainty
    assert np.max(np.abs(apart[:6])) < 0.1
    assert mended.standard_uncertainty == pytest.approx(at_once.standard_uncertainty, rel=0.05)
    off = mended.values[:6] - truth(PARAMETERS, PAPER.names())
    assert np.max(np.abs(off / mended.standard_uncertainty[:6])) < 3.5


@pytest.mark.slow
def test_a_rest_beside_the_middle_of_the_contact_is_found_and_covered() -> None:
    """Of 0.5 arcsec at 10 arcsec, n, T0 and gamma lay 5 u off, and a shutter and its rows had the blame."""
    parameters, pendulum = paper_pair("silicon")
    pull = (2 * np.pi / parameters.period0_s) ** 2 * 0.5 * ARCSEC
    points, harmonics = seen_decay(
        parameters, pendulum, q=1e-9, seed=1, last_arcsec=10.0, noise_seed=1,
        forcing=lambda time_s: np.full(len(time_s), pull),
    )  # fmt: skip
    assert not row_delay(harmonics, parameters.period0_s).seen
    fit = fit_exact(points, pendulum)
    found = time_alternation(LinearisedFit.of(points, pendulum, fit))
    assert not found.rows.seen
    assert found.rest_rad.value / ARCSEC == pytest.approx(0.5, rel=0.2)
    (text,) = found.taken_off_texts
    assert "beside the middle" in text
    evened = without_alternation(points, found)
    fit = fit_exact(evened, pendulum, near=fit)
    at = LinearisedFit.of(evened, pendulum, fit)
    assert not time_alternation(at).rest_seen
    wider, off = with_rest_position(at, found, fit), []
    moved = dict(zip(wider.names, wider.terms[REST_POSITION][:, 0], strict=True))
    for name in ("c", "n", "period0_s", "gamma_pa"):
        value, u = fit.estimate(name)
        off.append(abs(value - getattr(parameters, name)) / u)
        assert abs(value - getattr(parameters, name)) < 2.5 * wider.estimate(name).standard_uncertainty, name
        if off[-1] > 2.5:
            # the part of the friction is less well known than that of elasticity
            share = moved[name] / (value - getattr(parameters, name))
            assert share == pytest.approx(1.0, abs=0.6 if name == "c" else 0.25), name
    assert max(off) > 2.5
    rest_rad = found.rest_rad.value
    chance = found._replace(rest_rad=Estimate(rest_rad, rest_rad / 1.9))
    assert with_rest_position(at, chance, fit) is fit


@pytest.mark.parametrize("delay_s_per_rad", [0.0, DELAY_S_PER_RAD])
def test_the_second_harmonic_is_that_of_rows(delay_s_per_rad: float) -> None:
    """Frames whose spot was exposed by its place later, through detector and harmonics."""
    rate = 25.0
    dense = driven_path(PARAMETERS, PENDULUM, q=8e-9, seed=1, frames_per_s=10 * rate)[2]
    path = scipy.interpolate.CubicSpline(np.arange(len(dense)) / (10 * rate), dense)
    frame_s = np.arange(0.0, len(dense) / (10 * rate) - 1.0, 1 / rate)
    at_s = frame_s.copy()
    for _ in range(4):
        at_s = frame_s + delay_s_per_rad * path(at_s)
    samples = seen_in_frames(path(at_s), 0.005 * ARCSEC, 3, rate)
    found = row_delay(points_and_harmonics(samples)[1], PARAMETERS.period0_s)
    assert found.seen is bool(delay_s_per_rad)
    # pieces of a decay have a mean amplitude only
    assert abs(found.delay_s_per_rad - delay_s_per_rad) < 0.05 * delay_s_per_rad + 4 * found.u_delay_s_per_rad
    assert "µs a row" in found.text(2.4e-6)
