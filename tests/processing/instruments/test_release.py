"""The release of a held pendulum against worlds that are known in closed form, and what is none."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from processing.arrays import Floats
from processing.instruments.friction_law import HerbertHardness, herbert_hardness
from processing.instruments.release import with_release
from processing.instruments.turning import refined_turning_points
from processing.swing import HalfCycle, half_cycles_of, turning_points

PERIOD_S, ANGLE, NOISE = 6.1, 0.0907, 2e-5
World = Callable[[Floats], Floats]
DRAG_PER_S, FRICTION = 0.013, 0.03


def dragged(time_s: Floats) -> Floats:
    omega = 2 * math.pi / PERIOD_S
    wave = np.cos(omega * time_s) + DRAG_PER_S / omega * np.sin(omega * time_s)
    return np.asarray(ANGLE * np.exp(-DRAG_PER_S * time_s) * wave)


def rubbed(time_s: Floats) -> Floats:
    """Friction b |phi|: a spring 1 - b times as hard inwards, 1 + b times as hard outwards."""
    inwards, outwards = (2 * math.pi / PERIOD_S * math.sqrt(1 + sign * FRICTION) for sign in (-1, 1))
    quarter_s = 0.5 * math.pi / inwards
    half_s = quarter_s + 0.5 * math.pi / outwards
    swing = np.maximum(np.floor(time_s / half_s), 0.0)
    since_s = time_s - swing * half_s
    wave = np.where(
        since_s < quarter_s,
        np.cos(inwards * since_s),
        -inwards / outwards * np.sin(outwards * (since_s - quarter_s)),
    )
    return np.asarray(ANGLE * (-inwards / outwards) ** swing * wave)


WORLDS: dict[str, tuple[World, float, float]] = {
    "drag": (dragged, 0.5 * PERIOD_S, math.exp(-0.5 * DRAG_PER_S * PERIOD_S)),
    "friction": (
        rubbed,
        0.25 * PERIOD_S * ((1 - FRICTION) ** -0.5 + (1 + FRICTION) ** -0.5),
        math.sqrt((1 - FRICTION) / (1 + FRICTION)),
    ),
}


def released(time_s: Floats, y: Floats, seed: int) -> list[HalfCycle] | None:
    """Half-cycles of what is seen with noise, from the release on."""
    y = y + NOISE * np.random.default_rng(seed).standard_normal(len(y))
    samples = np.round(1e9 * time_s).astype(np.int64), y, np.full(len(y), NOISE)
    return with_release(*samples, refined_turning_points(*samples, half_cycles_of(*samples)))


def measured(world: World, hold_s: float, rate_hz: float, seed: int, side: int) -> HerbertHardness:
    time_s = np.arange(0, hold_s + 36, 1 / rate_hz)
    y = np.where(time_s < hold_s, ANGLE, world(np.maximum(time_s - hold_s, 0.0)))
    return herbert_hardness(turning_points(released(time_s, side * y + 0.004, seed)))


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize(("hold_s", "rate_hz"), [(0.1, 100.0), (7.0, 100.0), (0.6, 20.0)])
def test_herbert_begins_with_the_release(name: str, hold_s: float, rate_hz: float) -> None:
    """The first swing was the second one: ten swings 3 and the scale 3 uncertainties off."""
    world, half_s, kept = WORLDS[name]
    pulls = []
    for seed in range(3):
        found = measured(world, hold_s, rate_hz, seed, 1 - 2 * (seed % 2))
        truths = (10 * half_s, 10 * half_s, 50 * (1 + kept))
        values = (found.ten_swings_s, found.first_swing_times_ten_s, found.scale_hardness)
        pulls.append(
            [(v.value - truth) / v.standard_uncertainty for v, truth in zip(values, truths, strict=True)]
        )
    assert np.abs(np.mean(pulls, axis=0)).max() < 2.0
    assert np.sqrt(np.mean(np.square(pulls))) < 1.8


@pytest.mark.parametrize("kind", ["pushed", "creeping", "moving"])
def test_a_start_that_is_no_release_is_none(kind: str) -> None:
    time_s = np.arange(0, 40, 0.01)
    before = {
        "pushed": 0.0 * time_s,
        "creeping": ANGLE + 2e-3 * (time_s - 2.0),
        "moving": dragged(time_s - 2.0),
    }
    swing = dragged(time_s - 2.0 + (0.25 * PERIOD_S if kind == "pushed" else 0.0))
    assert released(time_s, np.where(time_s < 2.0, before[kind], swing), 1) is None
