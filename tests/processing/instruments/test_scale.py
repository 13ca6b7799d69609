"""Effect of the scale's uncertainty on reported values: known derivatives, and actual scatter."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments.crossings import circular_error
from processing.instruments.damping_fit import DampingTime, SharedError, damping, with_shared
from processing.instruments.descriptions import DEGREE_RAD
from processing.instruments.friction_law import rolling_friction
from processing.swing import TurningPoints
from tests.processing.instruments.test_instruments import decay, exponential

SCALE = SharedError("arm", scale=0.01)


def falling_evenly() -> TurningPoints:
    """Constant friction: 13 to 3 degrees in equal steps."""
    return decay(np.linspace(13.0, 3.0, 400) * DEGREE_RAD, u_rad=1e-9)


def of_even(points: TurningPoints) -> DampingTime:
    return damping(points, 12 * DEGREE_RAD, 4 * DEGREE_RAD)


def scaled(points: TurningPoints, factor: float) -> TurningPoints:
    return replace(points, amplitude=points.amplitude * factor)


def test_damping_of_an_exponential_decay_does_not_depend_on_the_scale() -> None:
    points = exponential(7.0, 0.01, 200)
    plain = damping(points, 6 * DEGREE_RAD, 3 * DEGREE_RAD)
    found = with_shared(lambda at: damping(at, 6 * DEGREE_RAD, 3 * DEGREE_RAD), points, [SCALE])[0]
    assert found.time_s.value == plain.time_s.value
    assert found.time_s.standard_uncertainty == pytest.approx(plain.time_s.standard_uncertainty, rel=1e-6)


def test_damping_time_scatters_as_claimed_where_friction_is_constant() -> None:
    """Records read with wrong scales, drawn with the stated uncertainty."""
    u_scale, random = 0.01, np.random.default_rng(5)
    errors = u_scale * random.normal(size=200)
    times_s = [of_even(scaled(falling_evenly(), 1 + error)).time_s.value for error in errors]
    claimed = with_shared(of_even, falling_evenly(), [SharedError("arm", scale=u_scale)])[0].time_s
    # the standard deviation of 200 values is known to 1/sqrt(400) = 5 %
    assert np.std(times_s, ddof=1) == pytest.approx(claimed.standard_uncertainty, rel=0.15)


def test_a_moment_and_a_circular_factor_go_with_the_scale() -> None:
    points = falling_evenly()
    found = with_shared(
        lambda at: rolling_friction(at, Estimate(0.02, 0.0), Estimate(0.002, 0.0)), points, [SCALE]
    )[0]
    # the loss goes as 1 - cos of the amplitudes over their path: by the first power of the scale
    assert found.coefficient.standard_uncertainty / found.coefficient.value == pytest.approx(0.01, rel=0.05)
    longer_s = np.cumsum(np.gradient(points.time_s) * points.amplitude**2 / 16)
    points = replace(points, time_s=points.time_s + longer_s)
    plain, wide = circular_error(points), with_shared(circular_error, points, [SCALE])[0]
    assert plain.factor.value == pytest.approx(1.0, rel=0.01)
    added = np.sqrt(wide.factor.standard_uncertainty**2 - plain.factor.standard_uncertainty**2)
    assert added == pytest.approx(0.02 * abs(plain.factor.value), rel=0.05)


def test_amplitudes_that_only_just_suffice() -> None:
    """Made larger by 2 % this record does not reach 3 degrees; made smaller it does."""
    points = exponential(7.0, 0.01, 86)
    assert points.amplitude[-1] * 1.02 > 3 * DEGREE_RAD > points.amplitude[-1]

    def reduce(at: TurningPoints) -> DampingTime:
        return damping(at, 6 * DEGREE_RAD, 3 * DEGREE_RAD)

    wide = SharedError("arm", scale=0.02)
    assert with_shared(reduce, points, [wide])[0].time_s.value == reduce(points).time_s.value
    with pytest.raises(DataError, match="never reaches"):
        with_shared(reduce, scaled(points, 1.02), [wide])
    # of constant friction: a larger scale makes the time shorter, also where only a smaller one is tried
    even = falling_evenly()
    short = even.first(int(np.argmax(even.amplitude < 4 * DEGREE_RAD)) + 1)
    for record in (even, short):
        found, readings = with_shared(of_even, record, [SCALE])
        assert readings["time_s"].shared["arm"] == pytest.approx(-0.01 * found.time_s.value, rel=0.03)
