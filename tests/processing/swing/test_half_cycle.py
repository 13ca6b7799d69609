"""The step to the next turning point, whose derivatives are those that differences find; limits of flags."""

import numpy as np
import pytest

from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    FAST_COSINE,
    FAST_DAMPING,
    FAST_RATE,
    FAST_SINE,
    RATE,
    SHAPE,
    STATES,
    TIME,
    linearise,
    propagate,
    tabulated,
)
from processing.swing.half_cycle_fit import HalfCycleFit
from processing.swing.judgement import judge
from processing.swing.noise import NoiseLevel
from processing.swing.turning_point import HalfCycleFlag
from processing.swing.waveform import BEND, DAMPING, DRY, RISE, STIFF, N, P

REFERENCE = 100.0
STATE = np.zeros(STATES)
STATE[[AMPLITUDE, TIME, RATE, CENTRE, DRIFT]] = 80.0, 0.02, 1.54, 3.0, 0.01
STATE[[FAST_COSINE, FAST_SINE, FAST_RATE, FAST_DAMPING]] = 0.4, -0.7, 7.7, 0.05
TERMS = SHAPE + np.array([DAMPING, DRY, RISE, P, STIFF, N, BEND])
STATE[TERMS] = 0.004, 0.006, 0.02, 0.85, 0.03, 0.3, 0.01
ELAPSED_S = 2.03


def stepped(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, turn = tabulated(x, STATE, REFERENCE, np.arange(STATES))
    return propagate(x, turn, ELAPSED_S)


def left_of_zeros(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals and derivatives at samples of zero before and after the turning point."""
    tau, active = np.linspace(-1.1, 1.3, 25), np.arange(STATES)
    table, _ = tabulated(x, STATE, REFERENCE, active)
    residual, jacobian = np.empty(len(tau)), np.empty((len(tau), STATES))
    linearise(x, -1.0, active, table, tau, np.zeros(len(tau)), residual, jacobian)
    return residual, jacobian


@pytest.mark.parametrize("column", range(STATES))
def test_derivatives_of_the_step_and_of_every_sample_are_those_of_differences(column: int) -> None:
    """One sign of the transition that is wrong makes every covariance of the filter wrong, and no value."""
    width = 1e-5 * max(abs(STATE[column]), 1e-2)
    ahead, behind = STATE.copy(), STATE.copy()
    ahead[column] += width
    behind[column] -= width
    found = (stepped(ahead)[0] - stepped(behind)[0]) / (2 * width)
    assert found == pytest.approx(stepped(STATE)[1][:, column], rel=1e-4, abs=1e-7)
    found = (left_of_zeros(behind)[0] - left_of_zeros(ahead)[0]) / (2 * width)
    expected = left_of_zeros(STATE)[1][:, column]
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-5 * np.abs(expected).max())


def fitted(**changed: float) -> HalfCycleFit:
    """A half-cycle of 100 samples in 2 s without a fault, but for what has `changed`."""
    calm = HalfCycleFit(
        True, 1.0, 0.0, 0.001, 0.001, 0.0, 0.001, 98.0, 100, 0, 1.0, 1.0, 0.0, 0.02, STATE, np.eye(STATES)
    )
    return calm._replace(**changed)


@pytest.mark.parametrize(
    ("flag", "good", "bad"),
    [
        (HalfCycleFlag.GAP, {"gap_s": 0.239}, {"gap_s": 0.241}),
        # 3.5 times the spacing of 9 samples, 0.2 s
        (HalfCycleFlag.GAP, {"samples": 9, "chi2": 7.0, "gap_s": 0.69}, {"samples": 9, "gap_s": 0.71}),
        (HalfCycleFlag.GAP, {"samples": 7, "chi2": 5.0}, {"samples": 6, "chi2": 4.0}),
        # 5 and 5.5 standard deviations of a normal quantity: 184.6 of 98 degrees of freedom, 60.4 of 12
        (HalfCycleFlag.VIBRATION, {"chi2": 184.0}, {"chi2": 186.0}),
        (HalfCycleFlag.VIBRATION, {"worst_segment": 60.0 / 12}, {"worst_segment": 63.0 / 12}),
        (HalfCycleFlag.VIBRATION, {"outliers": 4}, {"outliers": 5}),
        (HalfCycleFlag.VIBRATION, {"time_s": 0.299}, {"time_s": -0.301}),
        (HalfCycleFlag.LOW_AMPLITUDE, {"u_amplitude": 0.199}, {"u_amplitude": 0.201}),
    ],
)
def test_a_half_cycle_is_flagged_beyond_its_limit(
    flag: HalfCycleFlag, good: dict[str, float], bad: dict[str, float]
) -> None:
    assert judge(fitted(**good), NoiseLevel(1.0), 0.0, 2.0) == 0
    assert judge(fitted(**bad), NoiseLevel(1.0), 0.0, 2.0) & flag
    # twice the noise is four times the chi-square; of slow noise half as many samples are independent
    slow = NoiseLevel(2.0, concentration=2.0)
    assert judge(fitted(chi2=4 * 230.0, worst_segment=4 * 7.8), slow, 0.0, 2.0) == 0
    # 115.3 of 49 degrees of freedom, 47.0 of 6
    assert judge(fitted(chi2=4 * 234.0), slow, 0.0, 2.0) == HalfCycleFlag.VIBRATION
    assert judge(fitted(worst_segment=4 * 8.4), slow, 0.0, 2.0) == HalfCycleFlag.VIBRATION
