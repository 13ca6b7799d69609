"""A pendulum that the ground drives, or that is read through air: followed, and with honest uncertainties."""

import math
from dataclasses import asdict
from functools import cache

import numpy as np
import pytest

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.swing import HalfCycleFlag, KnownMotion
from processing.swing.prediction import DrivenWalk
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair
from tests.processing.swing.truth import Errors, Record, air, damped_sinusoid, detect, errors, rms

PER_ACCELERATION = 2e-4 / (9.80665 * 6.05e-3)
"""Angle per acceleration of the ground, in rad s^2/m, with the mass centre 0.2 mm high."""


@cache
def driven(contact: str, q: float, seed: int, frames_per_s: float = 25.0, noise: float = 0.005) -> Record:
    """A decay of the published contact in arcsec, driven by q rad/s^2/sqrt(Hz)."""
    contact_truth = asdict(paper_pair(contact)[0])
    period0_s = contact_truth["period0_s"]
    settings = SimulationSettings.model_validate(
        {
            "seed": seed,
            "contact": contact_truth,
            "fast": {"amplitude_arcsec": 0.0},
            "ground": {
                "model": "white" if q else "none",
                "white_m_per_s2_per_sqrt_hz": q / (2 * math.pi / period0_s) ** 2 / PER_ACCELERATION,
            },
        }
    )
    turns = true_turning_points(settings)
    path = true_path(settings, float(turns.time_s[-1]) + 0.6 * period0_s, frames_per_s)
    deflection = path.y_rad / ARCSEC_RAD
    return Record(
        path.times_ns,
        deflection + noise * np.random.default_rng(seed).standard_normal(len(deflection)),
        np.full(len(deflection), noise),
        turns.time_s,
        np.abs(turns.angle_rad) / ARCSEC_RAD,
    )


def agrees(e: Errors, largest: float) -> bool:
    """Whether uncertainties are neither too small nor much too large, once the drive has been learned.

    One half-cycle in a hundred is left out: those beside a disturbance.
    """
    learned = e.index > 40
    kept = int(0.99 * np.count_nonzero(learned))
    errors_over_u = (np.sort(np.abs(values[learned]))[:kept] for values in (e.amplitude, e.time))
    return all(0.7 < rms(values) < largest for values in errors_over_u)


@pytest.mark.slow
def test_a_strong_drive_is_motion_not_vibration() -> None:
    """3e-7 rad/s^2/sqrt(Hz): the driven motion is 0.3 arcsec rms, and all swings are above 2 arcsec."""
    record = driven("glass_k8", 3e-7, 1)
    e = errors(record, detect(record))
    assert len(e) >= 0.98 * len(record.turn_time_s)
    assert agrees(e, 1.5)


@pytest.mark.parametrize("q", [1e-8, 1e-7])
def test_uncertainties_on_a_driven_pendulum_are_those_of_measurement(q: float) -> None:
    """A half-cycle's own samples give 1.0 mas; a drive within it adds a third of what it adds between two."""
    step_arcsec = q * math.sqrt(4.071 / 2) / (4 * math.pi / 4.071) / ARCSEC_RAD
    record = driven("glass_k8", q, 1)
    half_cycles = detect(record)
    e = errors(record, half_cycles)
    assert len(e) >= len(record.turn_time_s) - 3
    assert agrees(e, 1.3)
    u = float(np.median([h.u_amplitude for h in half_cycles]))
    assert u < 1.3 * math.hypot(0.001, 0.4 * step_arcsec)


def test_a_knock_on_a_driven_pendulum_is_flagged() -> None:
    """Three bursts of 0.3 arcsec at 7 Hz, and two pushes by 3 arcsec, a hundred steps of the drive."""
    record = driven("glass_k8", 3e-7, 1)
    turns = record.turn_time_s
    burst, push = np.zeros(len(record.time_s)), np.zeros(len(record.time_s))
    for place in (100, 250, 400):
        since = np.clip(record.time_s - turns[place], 0.0, 0.8)
        burst += 0.3 * np.exp(-since / 0.3) * np.sin(2 * np.pi * 7.3 * since) * (since < 0.8)
    for place in (150, 350):
        push += 3.0 * np.sin(2 * np.pi / 4.07 * np.maximum(record.time_s - turns[place] - 0.9, 0.0))
    for disturbance, places in ((burst, (100, 250, 400)), (push, (150, 350))):
        half_cycles = detect(record.plus(disturbance))
        for place in places:
            hit = [s for s in half_cycles if abs(s.turn_time_ns * 1e-9 - turns[place]) < 3.1]
            assert any(s.flags & HalfCycleFlag.VIBRATION for s in hit)


@pytest.mark.slow
@pytest.mark.parametrize(("contact", "q"), [("glass_k8", 1e-7), ("steel", 0.0)])
def test_air_counts_in_the_uncertainties(contact: str, q: float) -> None:
    record = driven(contact, q, 1, 60.0, 0.0027)
    windy = record.plus(air(len(record.times_ns), 60.0, np.random.default_rng(5)))
    half_cycles = detect(windy)
    e = errors(windy, half_cycles)
    assert len(e) > 0.98 * len(record.turn_time_s)
    assert agrees(e, 1.4)


def test_a_rest_position_that_air_moves_takes_no_more_than_it_explains() -> None:
    """Few samples in a half-cycle do not show air by their residuals: the rest position seems to move."""
    rng = np.random.default_rng(2)
    record = damped_sinusoid(rng, 120.0, 40.0, 400, frames_per_s=10.0, period_s=4.4)
    windy = record.plus(1.5 * air(len(record.times_ns), 10.0, rng))
    motion = KnownMotion(2 * math.pi / 4.4, 120.0, math.log(3.0) / (400 * math.pi))
    e = errors(windy, detect(windy, known=motion))
    assert len(e) > 390
    # a fit sees the rest of the scatter and allows for it; uncertainties that are too large it must believe
    assert agrees(e, 1.7)


def test_without_drive_nothing_is_learned() -> None:
    """White noise as stated: uncertainties at the bound of a half-cycle's own samples."""
    record = driven("silicon", 0.0, 1)
    half_cycles = [s for s in detect(record) if not s.flags]
    u = np.array([h.u_amplitude for h in half_cycles[50:]])
    assert u.max() < 1.1 * 0.005 * math.sqrt(2 / (25.0 * 4.072 / 2))


def test_the_variance_of_a_drive_is_learned_from_both_differences() -> None:
    """Ratios of 9 and 8 to their variances: running means over 16 half-cycles exceed 4 at the third."""
    walk = DrivenWalk()
    assert [walk.learn((3.0, -2.0), (1.0, 0.5), 0.5, rest_moves=False) for _ in range(3)] == [0, 0, 1]
    # half of what both squares exceed their variances by
    assert walk.variance == pytest.approx(0.5 * (13 - 1.5))
    of_drive = 1 + np.square([0.33, 0.35, 0.37]) * 5.75 / 0.25
    assert walk.inflation(0.5) == pytest.approx(tuple(np.sqrt(of_drive)))
    # no difference counts as more than four standard deviations, in the mean of three
    walk.learn((30.0, -30.0), (6.75, 6.25), 0.5, rest_moves=False)
    assert walk.variance == pytest.approx(5.75 + 0.5 * (6.75 + 6.25) * (4**2 - 1) / 3)
    # where a step is below a fifth of the resolution there is no drive
    walk.learn((0.0, 0.0), (40.0, 40.0), 50.0, rest_moves=False)
    assert (walk.variance, walk.inflation(50.0)) == (0.0, (1.0, 1.0, 1.0))
