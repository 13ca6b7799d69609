"""Swings and balance estimated beside the frames: the same values, and no frame waits for them."""

import threading

import numpy as np
import pytest

from calibration.axes_fit import Axes
from processing.balance import BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import DataError
from processing.spot import SensorModel
from processing.swing import TurningPointDetector
from rig.instrument.pipeline import Estimates, EstimateThread, Optics, Pipeline

ARCSEC_RAD = np.pi / 180 / 3600


def swinging(duration_s: float) -> list[Deflections]:
    """A swing in both axes at 100 frames/s, with noise, in blocks of 40 frames."""
    random = np.random.default_rng(4)
    time_s = np.arange(0, duration_s, 0.01)
    noise = random.normal(0, 0.02, (2, len(time_s)))
    slow = 300 * np.exp(-time_s / 300) * np.cos(2 * np.pi * time_s / 4.07)
    fast = 5 * np.cos(2 * np.pi * time_s / 1.31)
    x_rad, y_rad = (fast + noise[0]) * ARCSEC_RAD, (slow + noise[1]) * ARCSEC_RAD
    u_rad = np.full(len(time_s), 0.02 * ARCSEC_RAD)
    whole = Deflections(
        np.round(time_s * 1e9).astype(np.int64), x_rad, y_rad, u_rad, u_rad, DeflectionUnit.RAD
    )
    return [whole[first : first + 40] for first in range(0, len(time_s), 40)]


def test_the_same_swings_and_balances_as_in_line() -> None:
    blocks = swinging(40.0)
    detector = TurningPointDetector()
    half_cycles = [h for block in blocks for h in detector.update(block.times_ns, block.y, block.u_y)]
    half_cycles += detector.finish()
    assert len(half_cycles) > 15
    estimator = BalanceEstimator()
    in_line = [balance for block in blocks for balance in estimator.update(block)]
    assert len(in_line) > 4
    pipeline = Pipeline(Optics(SensorModel(39.2, 7.0, 255), None, Axes()), (640, 320), threaded=True)
    found = [pipeline.estimate(block) for block in blocks]
    last_swings, last_balances = pipeline.finish()
    threaded = [balance for _, balances in found for balance in balances] + last_balances
    assert [repr(balance) for balance in threaded] == [repr(balance) for balance in in_line]
    assert [*(h for half_cycles, _ in found for h in half_cycles), *last_swings] == half_cycles


def test_frames_that_come_one_by_one_are_gathered_and_give_the_same() -> None:
    whole = joined(swinging(20.0), DeflectionUnit.RAD)
    estimator, asked = BalanceEstimator(), []

    def estimate(samples: Deflections) -> Estimates:
        asked.append(len(samples))
        return [], estimator.update(samples)

    in_line = BalanceEstimator().update(whole)
    threaded = EstimateThread(estimate)
    found = [one for k in range(len(whole)) for one in threaded.update(whole[k : k + 1])[1]]
    found += threaded.finish()[1]
    assert [repr(balance) for balance in found] == [repr(balance) for balance in in_line]
    assert sum(asked) == len(whole)
    assert len(asked) < len(whole) / 5


def test_samples_are_taken_while_an_estimate_is_being_made() -> None:
    going_on = threading.Event()
    seen: list[int] = []

    def slow(block: Deflections) -> Estimates:
        assert going_on.wait(30.0)
        seen.append(len(block))
        return [], []

    threaded = EstimateThread(slow)
    blocks = swinging(4.0)
    for block in blocks:
        assert threaded.update(block) == ([], [])
    assert not seen
    going_on.set()
    assert threaded.finish() == ([], [])
    assert seen == [len(block) for block in blocks]


def test_an_error_is_raised_in_the_thread_that_asks() -> None:
    def failing(_: Deflections) -> Estimates:
        raise DataError("times, deflections and uncertainties must be of one length")

    threaded = EstimateThread(failing)
    block = swinging(1.0)[0]

    def ask() -> None:
        threaded.update(block)
        threaded.finish()

    with pytest.raises(DataError, match="one length"):
        ask()
