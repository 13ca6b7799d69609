"""The forecast of a decay's end agrees with simulated decays of the paper's three pairs."""

import math
import os
import subprocess
import sys
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.simulation.settings import ContactTruth, GroundTruth, SimulationSettings
from acquisition.simulation.true_path import true_turning_points
from processing.decay_summary import forecast
from tests.processing.fit.decays import ARCSEC, PAIRS, paper_pair


@pytest.mark.parametrize("pair", PAIRS)
def test_the_end_lies_within_three_uncertainties_from_early_on(pair: str) -> None:
    truth = true_turning_points(SimulationSettings(contact=ContactTruth(**asdict(paper_pair(pair)[0]))), 2.0)
    u = np.full(len(truth.time_s), 0.005 * ARCSEC)
    noise = np.random.default_rng(8).normal(0.0, 0.005 * ARCSEC, len(u))
    amplitudes = np.abs(truth.angle_rad) + noise
    end_s = truth.time_s[-1]
    uncertainties = []
    for part in (0.05, 0.2, 0.5, 0.9):
        seen = truth.time_s <= part * end_s
        found = forecast(truth.time_s[seen], amplitudes[seen], u[seen], 2.0 * ARCSEC)
        left_s = end_s - truth.time_s[seen][-1]
        # a period of four seconds is how finely the end itself is known
        assert abs(found.remaining_s - left_s) < 3 * math.hypot(found.u_remaining_s, 4.0), part
        assert found.u_remaining_s < 0.2 * left_s + 4.0
        uncertainties.append(found.u_remaining_s)
    assert uncertainties[-1] < 0.5 * uncertainties[0]


def test_the_stated_uncertainty_is_that_of_forecasts_on_moving_ground() -> None:
    """Four runs in the basement; the run ends at the third amplitude in a row below the final one."""
    ground = GroundTruth(model="peterson", between_noise_models=0.5, mass_centre_height_m=2e-4)
    settings = SimulationSettings(contact=ContactTruth(), ground=ground)
    deviations = []
    for run in range(4):
        truth = true_turning_points(settings, 1.8, run=run)
        noise = np.random.default_rng((run, 9)).normal(0.0, 0.005 * ARCSEC, len(truth.time_s))
        amplitudes = np.abs(truth.angle_rad) + noise
        below = amplitudes < 2.0 * ARCSEC
        end_s = truth.time_s[2:][below[2:] & below[1:-1] & below[:-2]][0]
        for part in (0.25, 0.5, 0.75):
            seen = truth.time_s <= part * end_s
            times_s, u = truth.time_s[seen], np.full(np.count_nonzero(seen), 0.005 * ARCSEC)
            told = forecast(times_s, amplitudes[seen], u, 2.0 * ARCSEC)
            half_period_s = float(np.median(np.diff(times_s)))
            left_s = end_s - times_s[-1] - 2.5 * half_period_s
            u_s = math.hypot(told.u_remaining_s, half_period_s / math.sqrt(12.0))
            deviations.append((told.remaining_s - left_s) / u_s)
    # it was three, as long as the ground was left out
    assert 0.5 < math.sqrt(np.mean(np.square(deviations))) < 1.8


def test_a_decay_far_from_what_is_expected_of_friction() -> None:
    """An exponent of 0.6 is 4.5 uncertainties from the prior's, and half a decay determines it no better.

    With either sign of the prior turned the forecasts are wrong by more than a tenth.
    """
    p, d, final, end_s, u = 0.6, 0.25, 2.0, 1200.0, 0.3
    fall = np.geomspace(120.0, final, 20_001)
    pace = 1.0 / (fall**p + d * final**p)
    passed = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * (fall[:-1] - fall[1:]))])
    times_s = np.arange(0.0, 0.6 * end_s, 2.04)
    amplitudes = np.interp(times_s, passed * end_s / passed[-1], fall)
    left_s = end_s - times_s[-1]
    wrong = []
    for seed in range(10):
        noise = u * np.random.default_rng(seed).standard_normal(len(times_s))
        found = forecast(times_s, amplitudes + noise, np.full(len(times_s), u), final)
        assert abs(found.remaining_s - left_s) < 3 * found.u_remaining_s
        wrong.append(found.remaining_s / left_s - 1.0)
    assert math.sqrt(np.mean(np.square(wrong))) < 0.07


@settings(max_examples=10, deadline=None)
@given(
    walk=st.floats(0.0, 1.5),
    last_arcsec=st.floats(1.9, 6.0),
    seed=st.integers(0, 1000),
)
def test_amplitudes_that_rise_and_fall_have_a_forecast(walk: float, last_arcsec: float, seed: int) -> None:
    """Near its end a decay in a basement rises as often as it falls."""
    rng = np.random.default_rng(seed)
    t = 2.08 * np.arange(200)
    decay = 7.0 * (last_arcsec / 7.0) ** (t / t[-1])
    amplitudes = np.abs(decay + walk * np.cumsum(rng.standard_normal(len(t))) * 0.3)
    found = forecast(t, amplitudes, np.full(len(t), 0.005), 1.8)
    assert found.u_remaining_s >= 0.0 or math.isnan(found.u_remaining_s)


def test_too_little_and_too_late() -> None:
    t = np.arange(4) * 2.0
    assert math.isnan(forecast(t, 100 - t, np.ones(4), 2.0).remaining_s)
    t = np.arange(40) * 2.0
    assert forecast(t, np.exp(-t), np.full(40, 1e-3), 2.0).remaining_s == 0.0
    growing = forecast(t, np.exp(0.01 * t) + 5, np.full(40, 1e-3), 2.0)
    assert math.isnan(growing.remaining_s)


FIRST_FORECAST = """
import sys
import numpy as np
from processing import decay_summary as decay_forecast
decay_forecast.prepare()
before = set(sys.modules)
times_s = np.linspace(0.0, 100.0, 50)
amplitudes = np.exp(-times_s / 100.0)
found = decay_forecast.forecast(times_s, amplitudes, np.full(50, 1e-3), 0.2)
print(found.remaining_s > 0, sorted(set(sys.modules) - before))
"""


def test_nothing_is_imported_while_a_run_is_shown() -> None:
    """The laser of a run whose main thread imports is not switched off by Ctrl-C before the import ends."""
    words = [sys.executable, "-c", FIRST_FORECAST]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, env=environment, check=True)
    assert done.stdout.strip() == "True []"
