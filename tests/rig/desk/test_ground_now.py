"""The ground's spectrum while a run goes on: without the swing, as acceleration of the base."""

import math

import numpy as np
import pytest

from processing.deflections import Deflections, DeflectionUnit
from processing.swing import Swing, SwingDetector
from processing.units import ARCSEC_RAD
from rig.desk.run_history import GroundNow
from rig.settings import PendulumSettings

PERIOD_S, SHAKEN_HZ, RATE_HZ = 4.0, 3.1, 25.0
PENDULUM = PendulumSettings(mass_kg=0.4, ball_radius_m=2e-3, mass_centre_height_m=-2e-4)


def shaken(seconds: float, unit: DeflectionUnit = DeflectionUnit.RAD) -> tuple[Deflections, list[Swing]]:
    """A decaying swing of 100 arcsec, and 0.5 arcsec of something else beside it."""
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, seconds, 1 / RATE_HZ)
    swing = 100.0 * np.exp(-time_s / 600.0) * np.cos(2 * np.pi * time_s / PERIOD_S)
    y = swing + 0.5 * np.sin(2 * np.pi * SHAKEN_HZ * time_s) + 0.01 * rng.standard_normal(len(time_s))
    none, u = np.zeros_like(y), np.full_like(y, 0.01)
    times_ns = np.rint(time_s * 1e9).astype(np.int64)
    size = unit.shown_size
    found = Deflections(times_ns, none, y * size, u * size, u * size, unit)
    return found, list(SwingDetector().update(times_ns, found.y, found.u_y))


def fed(seconds: float, pendulum: PendulumSettings | None, unit: DeflectionUnit) -> GroundNow:
    ground = GroundNow(pendulum)
    deflections, swings = shaken(seconds, unit)
    ground.take(deflections, swings)
    return ground


def test_there_is_none_before_twenty_periods() -> None:
    ground = fed(15 * PERIOD_S, PENDULUM, DeflectionUnit.RAD)
    assert ground.spectrum(*ground.parts())["f"] == []
    assert GroundNow(None).spectrum([], []) == {
        "f": [],
        "left": [],
        "acceleration": [],
        "low": [],
        "high": [],
    }


def test_the_swing_is_not_in_it_and_the_rest_is_the_grounds_acceleration() -> None:
    ground = fed(30 * PERIOD_S, PENDULUM, DeflectionUnit.RAD)
    found = ground.spectrum(*ground.parts())
    top = int(np.argmax(found["left"]))
    assert found["f"][top] == pytest.approx(SHAKEN_HZ, rel=0.05), "no trace of the swing is as large"
    f, f0 = found["f"][top], 1 / PERIOD_S
    # an acceleration a turns it by a d/(g R) f0^2/(f^2 - f0^2)
    per_a = 2e-4 / (PENDULUM.gravity_m_per_s2 * 2e-3) * f0**2 / (f**2 - f0**2)
    assert found["acceleration"][top] == pytest.approx(
        1e9 * found["left"][top] * ARCSEC_RAD / per_a, rel=0.01
    )
    assert all(low < high for low, high in zip(found["low"], found["high"], strict=True))
    assert ground.spectrum(*ground.parts()) is found, "nothing new, no new spectrum"


def test_without_a_lever_or_a_height_only_what_is_left_is_told() -> None:
    for pendulum, unit in (
        (None, DeflectionUnit.PX),
        (PENDULUM.model_copy(update={"mass_centre_height_m": None}), DeflectionUnit.RAD),
    ):
        ground = fed(30 * PERIOD_S, pendulum, unit)
        found = ground.spectrum(*ground.parts())
        assert found["acceleration"] == []
        # 0.5 of a sine, whatever the unit: its mean square is its power in the bins about it
        f, left = np.array(found["f"]), np.array(found["left"])
        assert math.sqrt(np.trapezoid(left**2, f)) == pytest.approx(0.5 / math.sqrt(2), rel=0.3)


def test_what_is_kept_is_bounded() -> None:
    ground = GroundNow(None)
    deflections, swings = shaken(100 * PERIOD_S)
    for begin in range(0, len(deflections), 100):
        part = deflections[begin : begin + 100]
        now = [one for one in swings if part.times_ns[0] <= one.turn_time_ns <= part.times_ns[-1]]
        ground.take(part, now)
    blocks, kept = ground.parts()
    assert len(kept) == 60
    assert int(blocks[0].times_ns[-1]) >= kept[0].turn_time_ns
    assert sum(map(len, blocks)) < 0.7 * len(deflections)
