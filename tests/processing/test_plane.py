"""The plane of swing as a function of time, from the balances of a decay."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from processing.balance import Balance, plane_of_swing, rotate, square_axes
from processing.deflections import Deflections, DeflectionUnit

PERIOD_S, COUNT = 4.0, 150
U_RAD = 3e-6
RATE = 5e-4


def balance(time_s: float, angle_rad: float, amplitude: float, u_rad: float) -> Balance:
    unknown = dict.fromkeys(Balance.__slots__, math.nan)
    known = {
        "time_ns": round(1e9 * time_s),
        "unit": DeflectionUnit.RAD,
        "period_s": PERIOD_S,
        "amplitude": amplitude * abs(math.cos(angle_rad)),
        "line_angle_rad": math.remainder(angle_rad, math.pi),
        "u_line_angle_rad": u_rad,
    }
    return Balance(**{**unknown, **known})


def balances(angle: Callable[[float], float], seed: int = 1, across: float = 0.0) -> list[Balance]:
    """Balances of a decay to a tenth, with a motion across the line that does not fall with it."""
    draws = np.random.default_rng(seed)
    found = []
    for k in range(1, COUNT):
        time_s = PERIOD_S * k
        amplitude = 6e-4 * math.exp(-2.3 * k / COUNT)
        u = U_RAD * 6e-4 / amplitude
        noise = math.hypot(u, across / amplitude) * draws.standard_normal()
        found.append(balance(time_s, angle(time_s) + noise, amplitude, u))
    return found


TIMES_NS = np.rint(1e9 * PERIOD_S * np.linspace(0.5, COUNT - 0.5, 301)).astype(np.int64)


@pytest.mark.parametrize(
    ("angle", "most_terms"),
    [
        (lambda t: 0.02, 2),
        (lambda t: 0.02 + RATE * t, 2),
        (lambda t: 0.02 - RATE * t, 2),
        (lambda t: 0.1 * -math.expm1(-t / 60.0), 24),
        (lambda t: 1.4 + RATE * t, 2),
    ],
    ids=["still", "turning", "turning back", "coming to rest", "through the other axis"],
)
def test_the_curve_is_the_plane_within_its_uncertainty(
    angle: Callable[[float], float], most_terms: int
) -> None:
    pulls = []
    for seed in range(5):
        plane = plane_of_swing(balances(angle, seed), TIMES_NS)
        assert not plane.doubt
        assert len(plane.coefficients) <= most_terms
        start_s = TIMES_NS[0] * 1e-9
        true = np.array([angle(t * 1e-9) - angle(start_s) for t in TIMES_NS])
        off = plane.turned_rad(TIMES_NS) - true
        assert np.max(np.abs(off)) < 2e-4
        pulls.append(off[-40] / np.linalg.norm(plane.u_turned_rad(TIMES_NS), axis=1)[-40])
    if most_terms == 2:
        assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_the_ground_across_is_part_of_the_uncertainty() -> None:
    quiet = plane_of_swing(balances(lambda t: RATE * t), TIMES_NS)
    loud = plane_of_swing(balances(lambda t: RATE * t, across=1e-7), TIMES_NS)
    assert loud.u_mean_rate() > 20 * quiet.u_mean_rate()
    assert abs(loud.mean_rate() - RATE) < 3 * loud.u_mean_rate()
    assert not loud.doubt


@pytest.mark.parametrize(
    ("angle", "kept", "said"),
    [
        (lambda t: RATE * t, slice(0, 60), "is not known in"),
        (lambda t: 0.03 * t, slice(0, COUNT), "too fast"),
        (lambda t: 0.2 * math.sin(t * t), slice(0, COUNT), "scatters by"),
    ],
)
def test_what_cannot_be_followed_is_said(angle: Callable[[float], float], kept: slice, said: str) -> None:
    plane = plane_of_swing(balances(angle)[kept], TIMES_NS)
    assert said in plane.doubt


def test_a_gap_without_turning_points_leaves_the_plane_known() -> None:
    """As of a camera that was unplugged for a tenth of the decay."""
    kept = [one for one in balances(lambda t: RATE * t) if abs(one.time_ns - 300e9) > 34e9]
    seen = TIMES_NS[np.abs(TIMES_NS - 300e9) > 30e9]
    for turns_ns, doubt in ((seen, False), (TIMES_NS, True)):
        plane = plane_of_swing(kept, turns_ns)
        assert bool(plane.doubt) is doubt


def test_a_few_directions_are_no_plane() -> None:
    assert plane_of_swing(balances(lambda t: 0.0)[:5], TIMES_NS) is None


@pytest.mark.parametrize("oblique_rad", [0.0, 0.02, -0.02])
def test_deflections_are_turned_back_in_axes_at_any_angle(oblique_rad: float) -> None:
    """The fast axis lies at a right angle plus `oblique_rad` from the slow one, and both turn."""
    time_s = np.linspace(0.0, 40.0, 801)
    slow, fast, angle = np.cos(1.5 * time_s), 0.1 * np.cos(7.7 * time_s), 0.01 * time_s
    along = slow * np.cos(angle) - fast * np.sin(angle + oblique_rad)
    perp = slow * np.sin(angle) + fast * np.cos(angle + oblique_rad)
    x = perp / math.cos(oblique_rad)
    y = along + math.tan(oblique_rad) * perp
    u = np.full(len(x), 1e-3)
    seen = Deflections(np.rint(1e9 * time_s).astype(np.int64), x, y, u, u, DeflectionUnit.RAD)
    back = rotate(seen, angle, oblique_rad)
    np.testing.assert_allclose(back.y, slow, atol=1e-12)
    np.testing.assert_allclose(back.x, fast, atol=1e-12)
    np.testing.assert_allclose(square_axes(seen, oblique_rad).y, along, atol=1e-12)
    np.testing.assert_allclose(back.u_y, 1e-3, rtol=0.05)
