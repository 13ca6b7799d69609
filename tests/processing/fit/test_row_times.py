"""An unstated rolling shutter: its turning times alternate, which is seen, named and taken off."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from processing.contact.laws import PAPER
from processing.deflections import slow_deflections
from processing.fit import LinearisedFit, fit_exact, row_delay, time_alternation, without_alternation
from tests.processing.fit.decays import ARCSEC, paper_pair, truth
from tests.processing.fit.driven import driven_decay, driven_path
from tests.processing.fit.frames import points_and_harmonics

PARAMETERS, PENDULUM = paper_pair("glass_k8")
DELAY_S_PER_RAD = 12.5
"""30 us a row where the tilt of one row is 2.4e-6 rad: a sensor of 4.8 um at an arm of 1 m."""


@pytest.mark.slow
@pytest.mark.parametrize("q", [0.0, 1e-8])
def test_alternating_times_are_those_of_a_shutter(q: float) -> None:
    points = driven_decay(PARAMETERS, PENDULUM, q=q, noise_arcsec=0.005, seed=5)
    at_once = fit_exact(points, PENDULUM, averaged=False)
    assert not time_alternation(LinearisedFit.of(points, PENDULUM, at_once)).seen
    late = DELAY_S_PER_RAD * points.amplitude * (1 - 2 * (points.index % 2))
    seen = replace(points, time_s=points.time_s + late)
    fit = fit_exact(seen, PENDULUM, averaged=False)
    found = time_alternation(LinearisedFit.of(seen, PENDULUM, fit))
    assert found.seen
    assert found.delay_s_per_rad == pytest.approx(DELAY_S_PER_RAD, rel=0.01)
    assert "rolling shutter" in found.taken_off_text
    mended = fit_exact(without_alternation(seen, found), PENDULUM, averaged=False)
    names = PAPER.names()
    apart = (mended.values - at_once.values)[: len(names)] / at_once.standard_uncertainty[: len(names)]
    assert np.max(np.abs(apart)) < 0.1
    assert mended.standard_uncertainty == pytest.approx(at_once.standard_uncertainty, rel=0.05)
    off = (mended.values[: len(names)] - truth(PARAMETERS, names)) / mended.standard_uncertainty[: len(names)]
    assert np.max(np.abs(off)) < 3.5


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
    u = 0.005 * ARCSEC
    seen = path(at_s) + u * np.random.default_rng(3).standard_normal(len(at_s))
    times_ns = np.rint(frame_s * 1e9).astype(np.int64)
    samples = slow_deflections(times_ns, seen, np.full(len(seen), u))
    found = row_delay(points_and_harmonics(samples)[1], PARAMETERS.period0_s)
    assert found.seen is bool(delay_s_per_rad)
    # pieces of a decay have a mean amplitude only
    assert abs(found.delay_s_per_rad - delay_s_per_rad) < 0.05 * delay_s_per_rad + 4 * found.u_delay_s_per_rad
    assert "µs a row" in found.text(2.4e-6)
