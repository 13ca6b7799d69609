"""What a short piece of a seismometer says of its worth, against integrated oscillators that are driven."""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.errors import DataError
from processing.fit import Seismogram
from processing.pendulum_at_rest import SeismometerAtRest, seismometer_at_rest
from processing.units import ARCSEC_RAD

PERIOD_S, FRAMES_PER_S, STEPS = 4.08, 25.0, 4
Q = 1e-7
READING_RAD = 0.005 * ARCSEC_RAD
Floats = NDArray[np.float64]


def shaken(seconds: float, seeds: int) -> tuple[Floats, Floats, Floats]:
    """Times of frames, (seeds, frames) deflections, (seeds, frames) means of the drive, rad/s^2."""
    rng = np.random.default_rng(35)
    dt = 1 / (FRAMES_PER_S * STEPS)
    omega, damping = 2 * np.pi / PERIOD_S, 0.005 * 2 * np.pi / PERIOD_S
    rms = Q / np.sqrt(2 * dt)
    speed_rms = Q / np.sqrt(2) / np.sqrt(4 * damping)
    speed = speed_rms * rng.standard_normal(seeds)
    angle = speed_rms / omega * rng.standard_normal(seeds)
    frames = round(seconds * FRAMES_PER_S)
    seen, drive = np.empty((seeds, frames)), np.zeros((seeds, frames))
    for k in range(frames):
        for _ in range(STEPS):
            force = rms * rng.standard_normal(seeds)
            speed += dt * (-(omega**2) * angle - 2 * damping * speed + force)
            angle += dt * speed
            drive[:, k] += force / STEPS
        seen[:, k] = angle
    seen += READING_RAD * rng.standard_normal(seen.shape) + 3e-5
    return np.arange(frames) / FRAMES_PER_S, seen, drive


def judged(
    time_s: Floats, seen: Floats, drive: Floats, noise: float, *, late_s: float = 0.0, seed: int = 1
) -> list[SeismometerAtRest]:
    rng = np.random.default_rng(seed)
    own = noise * Q * np.sqrt(0.5 * FRAMES_PER_S) * rng.standard_normal(drive.shape)
    at_s = time_s - 0.5 / FRAMES_PER_S + late_s
    return [
        seismometer_at_rest(time_s, one, Seismogram(at_s, 1e9 * of[:, None], ("Z",)))
        for one, of in zip(seen, drive + own, strict=True)
    ]


@pytest.fixture(scope="module")
def minutes() -> tuple[Floats, Floats, Floats]:
    return shaken(60.0, 30)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "late_s"), [(0.1, 0.0), (1.0, 0.4)])
def test_the_factor_lies_within_its_bounds(
    minutes: tuple[Floats, Floats, Floats], noise: float, late_s: float
) -> None:
    found = judged(*minutes, noise, late_s=late_s)
    true = np.sqrt(1 + 1 / noise**2)
    assert np.mean([one.related for one in found]) > (0.99 if noise < 1 else 0.8)
    least, factor = (np.median([getattr(one, name) for one in found]) for name in ("lower_95", "factor"))
    # never more is promised than there is
    assert np.mean([one.lower_95 <= true for one in found]) >= 0.9
    assert least > 0.35 * true
    if noise < 0.3:
        # a tenth of the drive is less than what the reading leaves
        assert 0.5 * true < factor < true
    else:
        assert np.mean([one.lower_95 <= true <= one.upper_95 for one in found]) >= 0.85
        assert factor == pytest.approx(true, rel=0.15)


@pytest.mark.slow
def test_unrelated_records_agree_by_chance_as_often_as_is_stated(
    minutes: tuple[Floats, Floats, Floats],
) -> None:
    time_s, seen, drive = minutes
    found = judged(time_s, seen, np.roll(drive, 1, axis=0), 0.0)
    assert np.mean([one.related for one in found]) <= 0.1
    assert np.median([one.lower_95 for one in found]) == 1.0


def test_two_components_tell_together_what_neither_does(minutes: tuple[Floats, Floats, Floats]) -> None:
    time_s, seen, drive = minutes
    other = np.roll(drive[0], 700) * 2
    both = Seismogram(time_s - 0.02, np.column_stack([drive[0] + other, drive[0] - other]), ("N", "E"))
    one = seismometer_at_rest(time_s, seen[0], Seismogram(both.time_s, both.value[:, :1], ("N",)))
    found = seismometer_at_rest(time_s, seen[0], both)
    assert found.coherence > 0.95 > one.coherence
    assert found.chance_coherence > one.chance_coherence


def test_a_gap_costs_its_periods(minutes: tuple[Floats, Floats, Floats]) -> None:
    time_s, seen, drive = minutes
    there = (time_s < 20.0) | (time_s > 26.0)
    found = seismometer_at_rest(
        time_s, seen[0], Seismogram(time_s[there] - 0.02, drive[0][there, None], ("Z",))
    )
    whole = seismometer_at_rest(time_s, seen[0], Seismogram(time_s - 0.02, drive[0][:, None], ("Z",)))
    assert whole.steps - 6 <= found.steps <= whole.steps - 2
    assert found.coherence > 0.9


def test_what_cannot_be_judged_is_said(minutes: tuple[Floats, Floats, Floats]) -> None:
    time_s, seen, drive = minutes
    with pytest.raises(DataError, match="its values do not change"):
        seismometer_at_rest(time_s, seen[0], Seismogram(time_s, np.full((len(time_s), 1), 7.0), ("Z",)))
    late = Seismogram(time_s[900:], drive[0][900:, None], ("Z",))
    with pytest.raises(DataError, match="periods in common; at least 7 are needed"):
        seismometer_at_rest(time_s, seen[0], late)
    with pytest.raises(DataError, match="too short to see the ground"):
        seismometer_at_rest(time_s[:200], seen[0][:200], Seismogram(time_s, drive[0][:, None], ("Z",)))
