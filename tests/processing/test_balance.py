"""Balance: values and correct uncertainties, once per period, independent of the blocks."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from processing.balance import (
    Balance,
    BalanceEstimator,
    BalanceLimits,
    Room,
    WeightResponses,
    balance_checks,
    mass_centre_height_m,
    names_with_units,
)
from processing.deflections import Deflections, DeflectionUnit
from processing.units import ARCSEC_RAD

RATE, FAST_RATE, ANGLE, WIDTH, TURNING = 1.55, 7.5, 0.03, 0.01, 1e-4


def motion(seed: int, seconds: float = 80.0, frames_per_s: float = 100.0, fast: float = 5.0) -> Deflections:
    """Deflections of a pendulum out of balance, in px."""
    rng = np.random.default_rng([seed, 51])
    t = np.arange(round(seconds * frames_per_s)) / frames_per_s
    angle = ANGLE + TURNING * t
    long = 200.0 * np.exp(-0.002 * t) * np.cos(RATE * t + 1.0)
    short = WIDTH * 200.0 * np.exp(-0.002 * t) * np.sin(RATE * t + 1.0)
    x = long * np.sin(angle) + short * np.cos(angle) + fast * np.exp(-0.005 * t) * np.cos(FAST_RATE * t + 2.0)
    y = long * np.cos(angle) - short * np.sin(angle)
    x, y = x + 3.0 + 0.01 * t, y - 2.0 + 0.02 * t
    noise = 0.02 * rng.standard_normal((2, len(t)))
    u = np.full(len(t), 0.02)
    times_ns = np.round(t * 1e9).astype(np.int64)
    return Deflections(times_ns, x + noise[0], y + noise[1], u, u, DeflectionUnit.PX)


def estimates(deflections: Deflections, block: int = 1000) -> list[Balance]:
    estimator = BalanceEstimator()
    found: list[Balance] = []
    for i in range(0, len(deflections), block):
        found += estimator.update(deflections[i : i + block])
    return found


def deviations(b: Balance) -> list[float]:
    t = b.time_ns * 1e-9
    along = 200.0 * math.exp(-0.002 * t)
    swift = 5.0 * math.exp(-0.005 * t)
    return [
        (b.period_s - 2 * math.pi / RATE) / b.u_period_s,
        (b.transverse - swift) / b.u_transverse,
        (b.transverse_ratio - swift / along / math.cos(ANGLE + TURNING * t)) / b.u_transverse_ratio,
        (b.line_angle_rad - ANGLE - TURNING * t) / b.u_line_angle_rad,
        (b.rotation_rad_per_s - TURNING) / b.u_rotation_rad_per_s,
        (b.width_ratio - WIDTH) / b.u_width_ratio,
        (b.rest_x - 3.0 - 0.01 * t) / b.u_rest_x,
        (b.rest_y + 2.0 - 0.02 * t) / b.u_rest_y,
        (b.drift_x_per_s - 0.01) / b.u_drift_x_per_s,
        (b.drift_y_per_s - 0.02) / b.u_drift_y_per_s,
        (b.period_ratio - FAST_RATE / RATE) / b.u_period_ratio,
    ]


@pytest.mark.slow
def test_values_and_uncertainties() -> None:
    runs = 6
    # every second estimate: neighbours share samples
    table = np.array([[deviations(b) for b in estimates(motion(seed))[7::2]] for seed in range(runs)])
    table = table.reshape(-1, table.shape[-1])
    # rates look back over eight periods, so that only one in five of them is new
    scatter = np.full(table.shape[1], 1.0 / math.sqrt(2 * len(table)))
    scatter[[4, 8, 9]] *= 2.0
    assert np.all(np.abs(np.sqrt((table**2).mean(axis=0)) - 1.0) < 4.5 * scatter)
    assert np.all(np.abs(table.mean(axis=0)) < 4.5 * math.sqrt(2.0) * scatter)


def test_one_estimate_a_period() -> None:
    found = estimates(motion(1))
    steps = np.diff([b.time_ns for b in found]) * 1e-9
    assert steps[1:] == pytest.approx(2 * math.pi / RATE, abs=0.03)
    assert found[0].time_ns * 1e-9 < 10.0
    assert math.isnan(found[2].rotation_rad_per_s)
    assert math.isfinite(found[3].rotation_rad_per_s)


def test_no_fast_mode() -> None:
    found = estimates(motion(2, fast=0.0))
    assert all(b.transverse == 0.0 for b in found)
    assert all(0.0 < b.u_transverse < 0.01 for b in found)
    assert all(math.isnan(b.period_ratio) and math.isnan(b.u_period_ratio) for b in found)


MOTION = motion(3, 40.0)
WHOLE = estimates(MOTION, block=10**6)


@settings(max_examples=5, deadline=None)
@example([*range(len(MOTION))])
@given(st.lists(st.integers(0, len(MOTION)), max_size=20))
def test_blocks_do_not_matter(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(MOTION)]
    estimator = BalanceEstimator()
    found: list[Balance] = []
    for i, j in pairwise(edges):
        found += estimator.update(MOTION[i:j])
    assert repr(found) == repr(WHOLE)


@pytest.mark.parametrize(("frames_per_s", "lost"), [(500.0, slice(0)), (100.0, slice(1000, 1400))])
def test_a_high_frame_rate_and_lost_spots_are_as_good(frames_per_s: float, lost: slice) -> None:
    deflections = motion(6, 40.0, frames_per_s)
    deflections.x[lost] = np.nan
    found = estimates(deflections)
    assert len(found) >= 7
    assert np.abs(np.array([deviations(b)[:4] for b in found])).max() < 5.0


@pytest.mark.parametrize("frames_per_s", [5.0, 8.0, 10.0, 12.5, 15.0, 25.0])
def test_a_low_frame_rate_shows_that_the_plane_turns(frames_per_s: float) -> None:
    """In the first look of half a second are fewer frames than tell a swing from rest."""
    found = estimates(motion(8, 120.0, frames_per_s, fast=0.0))
    assert len(found) > 20
    for b in found[4:]:
        assert abs(b.rotation_rad_per_s - TURNING) < 4.0 * b.u_rotation_rad_per_s < 0.5 * TURNING


def test_rest_then_swing_then_rest() -> None:
    swinging = motion(5, 60.0)
    still = np.arange(len(swinging)) % 6000
    resting = (still < 1500) | (still > 4500)
    x, y = np.where(resting, 3.0, swinging.x), np.where(resting, -2.0, swinging.y)
    times = [b.time_ns * 1e-9 for b in estimates(replace(swinging, x=x, y=y))]
    assert len(times) > 4
    assert min(times) > 14.0
    assert max(times) < 47.0


@pytest.mark.slow
def test_memory_stays_flat() -> None:
    estimator = BalanceEstimator()
    sizes = []
    for k in range(12):
        t = (np.arange(2000) + 2000 * k) * 0.01
        y = 100.0 * np.cos(1.5 * t)
        times_ns = np.round(t * 1e9).astype(np.int64)
        noise = 0.01 * np.random.default_rng(k).standard_normal((2, 2000))
        u = np.full(2000, 0.01)
        estimator.update(Deflections(times_ns, noise[0], y + noise[1], u, u, DeflectionUnit.RAD))
        sizes.append(sum(map(len, estimator._blocks)))
    # a window of periods, less than one update brings
    assert 500 < max(sizes[5:]) < 2000


def test_px_are_never_called_rad_and_have_no_limits_in_arcsec() -> None:
    (balance, *_) = WHOLE
    assert balance.unit is DeflectionUnit.PX
    in_px, in_rad = (names_with_units(unit) for unit in (DeflectionUnit.PX, DeflectionUnit.RAD))
    assert {name for name in in_px if in_px[name] != in_rad[name]} >= {
        f"{u}{name}"
        for u in ("", "u_")
        for name in ("amplitude", "transverse", "rest_x", "rest_y", "drift_x_per_s", "drift_y_per_s")
    }
    assert (in_px["u_rest_x"], in_rad["drift_y_per_s"]) == ("u_rest_x_px", "drift_y_rad_per_s")
    assert [key for key in in_px.values() if "rad" in key] == [
        "line_angle_rad", "u_line_angle_rad", "rotation_rad_per_s", "u_rotation_rad_per_s",
    ]  # fmt: skip
    with pytest.raises(ValueError, match="a balance in px has no limits"):
        balance_checks(balance, (math.nan, math.nan), BalanceLimits())


def test_the_waveform_of_a_decay_by_friction_is_no_fast_mode() -> None:
    """A third harmonic of 5e-4, as friction leaves it, once the fast mode has gone."""
    sine = motion(4, fast=0.0)
    t = sine.times_ns * 1e-9
    y = sine.y + 5e-4 * 200.0 * np.exp(-0.002 * t) * np.cos(3.0 * (RATE * t + 1.0))
    for b in estimates(replace(sine, y=y))[2:]:
        assert math.isnan(b.period_ratio)
        assert b.transverse == 0.0
        # a fast mode weaker than the harmonic would not be seen beside it
        assert b.u_transverse > 0.9 * 5e-4 * b.amplitude


@pytest.mark.parametrize("rest_s", [0.0, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("shaking", [0.0, 0.05])
def test_the_first_balance_holds_nothing_of_what_was_before_the_release(
    rest_s: float, shaking: float
) -> None:
    """At rest, tilted by a starter for 0.62 s, then free; on a table that shakes nothing is at rest."""
    period_s, pulse_s, rate_hz = 4.071, 0.62, 60.0
    rng = np.random.default_rng(3)
    t = np.arange(0.0, rest_s + 30.0, 1.0 / rate_hz)
    w = 2.0 * np.pi / period_s
    tilt = 120.0 / abs(1.0 - np.exp(1j * w * pulse_s))
    pushed = np.clip(t - rest_s, 0.0, None)
    free = np.clip(pushed - pulse_s, 0.0, None)
    y = np.where(
        free > 0.0,
        np.exp(-0.002 * free) * tilt * (np.cos(w * free) - np.cos(w * pushed)),
        tilt * (1.0 - np.cos(w * pushed)),
    )
    y += 5.0 + shaking * np.sin(2.0 * np.pi * 1.3 * t) + rng.normal(0.0, 0.003, len(t))
    x = 3.0 + shaking * rng.standard_normal(len(t)) + rng.normal(0.0, 0.003, len(t))
    u = np.full(len(t), 0.003 * ARCSEC_RAD)
    times_ns = np.rint(1e9 * t).astype(np.int64)
    deflections = Deflections(times_ns, x * ARCSEC_RAD, y * ARCSEC_RAD, u, u, DeflectionUnit.RAD)
    found = BalanceEstimator().update(deflections)
    assert found
    for balance in found:
        # the damping of this motion is no friction's: 0.01 arcsec stay of it
        assert abs(balance.rest_y / ARCSEC_RAD - 5.0) < 0.01 + 3.0 * balance.u_rest_y / ARCSEC_RAD
        assert abs(balance.rest_y / ARCSEC_RAD - 5.0) < 0.05
        assert abs(balance.period_s - period_s) < 1e-3


def test_a_turn_is_judged_by_the_change_of_the_state_wherever_it_began() -> None:
    effect, u = np.array([40.0, -20.0, 0.0]), np.array([0.1, 0.1, 1e-7])
    before = np.array([300.0, 170.0, 1e-6])
    responses = WeightResponses({"a": (effect, 0.05 * np.abs(effect) + u)}, BalanceLimits())
    assert responses.can_make("a", 1.0, before, before + effect, u)
    assert not responses.can_make("a", 1.0, before, before + 9 * effect, u)
    assert responses.doubt("a", 1.0, before, before + effect, u) is None
    assert responses.doubt("a", 1.0, before, before - effect, u) is not None


def test_a_mass_centre_too_high_swings_slowly() -> None:
    gravity, mass, radius = 9.80665, 0.406, 6.05e-3
    inertia = mass * gravity * radius * (4.071 / (2 * math.pi)) ** 2
    assert mass_centre_height_m(4.071, inertia, mass, radius, gravity) == pytest.approx(0.0, abs=1e-12)
    slow = mass_centre_height_m(4.071 * 1.001, inertia, mass, radius, gravity)
    # l goes with 1/T^2: 0.1 % of the period is 0.2 % of the arm
    assert slow == pytest.approx(0.002 * radius, rel=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_balance_is_told_in_its_units_with_the_side_that_it_leans_to(side: float) -> None:
    (last, *_) = WHOLE
    balance = replace(
        last, unit=DeflectionUnit.RAD, rest_x=side * 3 * ARCSEC_RAD, rest_y=-side * 5 * ARCSEC_RAD,
        line_angle_rad=side * 0.1, rotation_rad_per_s=side * 0.01, u_rotation_rad_per_s=1e-4,
    )  # fmt: skip
    checks = {
        one.name: one for one in balance_checks(balance, (side * 4e-6, 1e-6), BalanceLimits(height_m=3e-6))
    }
    values = [checks[name].value for name in ("rest position X", "rest position Y", "mass centre")]
    assert values == pytest.approx([3 * side, -5 * side, 4 * side])
    assert (checks["mass centre"].u_value, checks["mass centre"].limit) == pytest.approx((1.0, 3.0))
    assert checks["angle of the line"].value == pytest.approx(side * 18 / math.pi)
    # 0.01 rad/s is 0.6 rad a minute
    assert (checks["spin"].value, checks["spin"].u_value) == pytest.approx(
        (side * 108 / math.pi, 1.08 / math.pi)
    )
    told = [checks[name].meaning for name in ("rest position X", "rest position Y", "mass centre")]
    assert ["+X" in told[0], "+Y" in told[1], "too high" in told[2]] == [side > 0, side < 0, side > 0]
    assert ("back from X" in checks["angle of the line"].meaning) == (side > 0)


def test_the_largest_swing_ends_at_the_nearest_edge_less_twice_the_uncertainty() -> None:
    """A rectangle to 90 and 50 arcsec, turned by 3-4-5; the pendulum swings along Y."""
    normals = np.array([[0.8, 0.6], [-0.8, -0.6], [-0.6, 0.8], [0.6, -0.8]])
    room = Room(normals, np.array([90.0, 90.0, 50.0, 50.0]))
    rest, u = np.array([10.0, 5.0]), np.array([3.0, 1.0])
    # from (10, 5): 79, 101, 52, 48; u across: hypot(2.4, 0.6), hypot(1.8, 0.8)
    nearest = (48 - 2 * math.hypot(1.8, 0.8)) / 0.8
    assert room.largest_swing_arcsec(rest, u) == pytest.approx(nearest)
    # without a swing to be had, how far the spot is beyond the edge
    beyond = 90 - (80 + 24) - 2 * math.hypot(2.4, 0.6)
    assert room.largest_swing_arcsec(np.array([100.0, 40.0]), u) == pytest.approx(beyond)
    upright = Room(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([20.0, 60.0]))
    assert upright.largest_swing_arcsec(np.array([5.0, 10.0]), 0 * u) == pytest.approx(50.0)
    assert upright.holds(np.array([19.0, 59.0]))
    assert not upright.holds(np.array([19.0, 61.0]))
