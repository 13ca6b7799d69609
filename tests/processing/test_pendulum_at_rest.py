"""What a pendulum at rest tells of the ground, and of a seismometer's worth, against driven oscillators."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.errors import DataError
from processing.fit import Seismogram
from processing.pendulum_at_rest import SeismometerAtRest, drive_at_rest, seismometer_at_rest
from processing.units import ARCSEC_RAD

PERIOD_S, FRAMES_PER_S, STEPS = 4.08, 25.0, 4
Q = 1e-7
READING_RAD = 0.005 * ARCSEC_RAD
Shaken = tuple[Floats, Floats, Floats]


def shaken(seconds: float, seeds: int, q: float = Q, reading_rad: float = READING_RAD) -> Shaken:
    """Times of frames, (seeds, frames) deflections, (seeds, frames) means of the drive, rad/s^2.

    Of pendulums that have been driven long enough to be steady.
    """
    rng = np.random.default_rng(35)
    dt = 1 / (FRAMES_PER_S * STEPS)
    omega, damping = 2 * np.pi / PERIOD_S, 0.005 * 2 * np.pi / PERIOD_S
    rms = q / np.sqrt(2 * dt)
    # steady state of x'' + 2 damping x' + omega^2 x = a
    speed_rms = q / np.sqrt(2) / np.sqrt(4 * damping)
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
    seen += reading_rad * rng.standard_normal(seen.shape) + 3e-5
    return np.arange(frames) / FRAMES_PER_S, seen, drive


def test_the_drive_comes_out_within_what_is_stated() -> None:
    q = 2e-8
    times_s, seen, _ = shaken(60.0, 25, q)
    found = [drive_at_rest(times_s, one) for one in seen]
    value, u = np.array([tuple(one.density) for one in found]).T
    seen_to_move = value > 0
    assert np.mean(seen_to_move) >= 0.9
    assert np.median(value) == pytest.approx(q, rel=0.1)
    # 14 periods give 28 steps, 1/sqrt(56) of the drive, and the reading takes its part
    assert np.std(value[seen_to_move]) < 0.3 * q
    assert 0.6 < np.sqrt(np.mean(((value - q) / u)[seen_to_move] ** 2)) < 1.6
    assert np.mean([one.upper_95 > q for one in found]) >= 0.85
    assert np.median([one.period_s for one in found]) == pytest.approx(PERIOD_S, rel=0.02)


def test_a_drive_below_the_reading_is_a_bound() -> None:
    times_s, seen, _ = shaken(60.0, 10, 1e-11, 4 * READING_RAD)
    found = [drive_at_rest(times_s, one) for one in seen]
    assert sum(one.density.value == 0 for one in found) >= 9
    assert all(1e-11 < one.upper_95 < 1e-7 for one in found)


def judged(
    time_s: Floats, seen: Floats, drive: Floats, noise: float, *, late_s: float = 0.0
) -> list[SeismometerAtRest]:
    own = noise * Q * np.sqrt(0.5 * FRAMES_PER_S) * np.random.default_rng(1).standard_normal(drive.shape)
    at_s = time_s - 0.5 / FRAMES_PER_S + late_s
    return [
        seismometer_at_rest(time_s, one, Seismogram(at_s, 1e9 * of[:, None], ("Z",)))
        for one, of in zip(seen, drive + own, strict=True)
    ]


@pytest.fixture(scope="module")
def minutes() -> Shaken:
    return shaken(60.0, 30)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "late_s"), [(0.1, 0.0), (1.0, 0.4)])
def test_the_factor_lies_within_its_bounds(minutes: Shaken, noise: float, late_s: float) -> None:
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
def test_unrelated_records_agree_by_chance_as_often_as_is_stated(minutes: Shaken) -> None:
    time_s, seen, drive = minutes
    found = judged(time_s, seen, np.roll(drive, 1, axis=0), 0.0)
    assert np.mean([one.related for one in found]) <= 0.1
    assert np.median([one.lower_95 for one in found]) == 1.0


def test_two_components_tell_together_what_neither_does_and_a_gap_costs_its_periods(minutes: Shaken) -> None:
    time_s, (seen, *_), (drive, *_) = minutes
    other = np.roll(drive, 700) * 2
    both = np.column_stack([drive + other, drive - other])
    there = (time_s < 20.0) | (time_s > 26.0)
    found, one, whole, gapped = (
        seismometer_at_rest(time_s, seen, Seismogram(at - 0.02, value, ("N", "E")[: value.shape[1]]))
        for at, value in (
            (time_s, both),
            (time_s, both[:, :1]),
            (time_s, drive[:, None]),
            (time_s[there], drive[there, None]),
        )
    )
    assert found.coherence > 0.95 > one.coherence
    assert found.chance_coherence > one.chance_coherence
    assert whole.steps - 6 <= gapped.steps <= whole.steps - 2
    assert gapped.coherence > 0.9


def test_what_cannot_be_judged_is_said(minutes: Shaken) -> None:
    time_s, seen, drive = minutes
    with pytest.raises(DataError, match="s of the pendulum at rest are too short"):
        drive_at_rest(np.linspace(0.0, 4.0, 100), np.zeros(100))
    for many, at, value, words in (
        (1500, time_s, np.full(len(time_s), 7.0), "its values do not change"),
        (1500, time_s[900:], drive[0][900:], "periods in common; at least 7 are needed"),
        (200, time_s, drive[0], "too short to see the ground"),
    ):
        with pytest.raises(DataError, match=words):
            seismometer_at_rest(time_s[:many], seen[0][:many], Seismogram(at, value[:, None], ("Z",)))
