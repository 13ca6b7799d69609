"""The action of a known acceleration, against an integration step by step and a fit to samples."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.fit.known_drive import Signals, known_drive
from processing.swing import TurningPoints
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path

RATE = 1.55
STEP_S = 0.05


def white(count: int, seed: int) -> Floats:
    return np.random.default_rng(seed).standard_normal(count)


def exact_points(time: Floats, amplitude: Floats) -> TurningPoints:
    tiny = np.full(len(time), 1e-12)
    return TurningPoints(np.arange(len(time), dtype=np.int64), time, tiny, amplitude, tiny)


def test_between_turning_points_it_does_what_an_integration_shows() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    drive = 3e-7 * white(8000, 4)
    clock: Floats = STEP_S * np.arange(len(drive), dtype=np.float64)
    free_time, free, _ = driven_path(parameters, pendulum, q=0.0, seed=0, last_arcsec=60.0)
    time, turn, _ = driven_path(
        parameters, pendulum, q=0.0, seed=0, last_arcsec=65.0, forcing=lambda t: np.interp(t, clock, drive)
    )
    amplitude, free = np.abs(turn), np.abs(free)
    # one half-swing of the free decay from the same amplitude
    loss = np.interp(-amplitude[:-1], -free[:-1], -np.diff(free))
    duration = np.interp(-amplitude[:-1], -free[:-1], np.diff(free_time))
    changes = np.array(
        [np.diff(amplitude) + loss, (np.diff(time) - duration) * 0.5 * (amplitude[1:] + amplitude[:-1])]
    )
    signals = Signals(clock, drive[:, None], 2 * STEP_S)
    found = known_drive(exact_points(time, amplitude), signals, averaged=False).steps[:, 1:, 0]
    for change, step in zip(changes, found, strict=True):
        assert np.std(change - step) < 0.006 * np.std(change)
    assert np.std(changes[0]) > 1e-8


def measured(offset: Floats, theta: Floats, *, rest: bool) -> Floats:
    """Amplitude, time times amplitude (s) and equilibrium position that least squares find in samples."""
    columns = [np.cos(theta), np.sin(theta) * RATE] + ([np.ones_like(theta)] if rest else [])
    return np.asarray(np.linalg.lstsq(np.column_stack(columns), offset, rcond=None)[0])


def response(turn_s: float, clock: Floats, drive: Floats) -> tuple[Floats, Floats]:
    """Phases, and an oscillator at rest at a turning point, forwards and backwards in small steps."""
    fine = 2e-4
    theta, offset = [], []
    for direction in (1.0, -1.0):
        x = v = t = 0.0
        while RATE * t < np.pi / 2:
            theta.append(direction * RATE * t)
            offset.append(x)
            push = float(np.interp(turn_s + direction * (t + 0.5 * fine), clock, drive))
            v += fine * (push - RATE**2 * (x + 0.5 * fine * v))
            x += fine * v
            t += fine
    return np.array(theta), np.array(offset)


@pytest.mark.parametrize("point", [4, 7])
def test_within_its_window_it_adds_to_a_measured_turning_point_what_a_fit_to_samples_finds(
    point: int,
) -> None:
    clock: Floats = STEP_S * np.arange(600, dtype=np.float64)
    drive = white(len(clock), 9)
    time: Floats = 3.0 + np.pi / RATE * np.arange(10, dtype=np.float64)
    points = exact_points(time, np.ones(10))
    signals = Signals(clock, drive[:, None], 2 * STEP_S)
    both = [known_drive(points, signals, averaged=averaged).steps[:, :, 0] for averaged in (True, False)]
    found = np.cumsum(both[0] - both[1], axis=1)[:, point]
    # a detector takes two thirds of the equilibrium from earlier half-cycles, the rest from this one
    rest = 0.0
    for k in range(point + 1):
        before = rest
        theta, offset = response(time[k], clock, drive)
        known, free = (measured(offset, theta, rest=with_rest) for with_rest in (False, True))
        rest = 2 / 3 * before + free[2] / 3
    side = (-1.0) ** point
    amplitude = (2 * known[0] + free[0]) / 3 - 2 / 3 * before * 4 / np.pi
    assert found[0] == pytest.approx(side * amplitude, rel=5e-3)
    assert found[1] == pytest.approx(side * known[1], rel=5e-3)


def test_a_gap_leaves_out_the_half_swings_that_meet_it() -> None:
    clock: Floats = STEP_S * np.arange(1000, dtype=np.float64)
    kept = (clock < 20.0) | (clock > 21.0)
    time: Floats = 3.0 + np.pi / RATE * np.arange(20, dtype=np.float64)
    signals = Signals(clock[kept], white(1000, 2)[kept, None], 2 * STEP_S)
    found = known_drive(exact_points(time, np.ones(20)), signals, averaged=False)
    meets = (time[1:] > 19.95) & (time[:-1] < 21.05)
    assert list(found.missing[1:]) == list(meets)
    assert not np.any(found.steps[:, found.missing])
    others = found.steps[0, ~found.missing, 0]
    assert found.unknown_variance(np.array([2.0]))[found.missing] == pytest.approx(4 * np.mean(others**2))
