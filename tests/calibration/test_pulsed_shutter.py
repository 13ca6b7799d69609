"""The row time is found from how bright a pulsed spot is in each row."""

import numpy as np
import pytest

from calibration.shutter import fit_row_time_of_pulses
from processing.errors import DataError

ROWS, EXPOSURE_S = 480, 8e-3


def pulsed_run(
    row_time_s: float, delay_s: float, pulse_s: float, noise: float = 0.005
) -> tuple[np.ndarray, ...]:
    """Times, rows and light of a swing, counted in slots of 1 us in which row and laser are open."""
    rng = np.random.default_rng(2)
    times_s = np.arange(3000) / 60.0
    y_px = 240.0 + 170.0 * np.exp(-times_s / 200.0) * np.cos(3.0 * times_s)
    slots_s = 1e-6 * (np.arange(30_000) + 0.5)
    lit = (slots_s > delay_s) & (slots_s < delay_s + pulse_s)
    first = y_px if row_time_s > 0 else ROWS - 1 - y_px
    opens_s = abs(row_time_s) * first
    before = np.concatenate([[0], np.cumsum(lit)]) * 1e-6
    places_s = np.arange(30_001) * 1e-6
    collected = np.interp(opens_s + EXPOSURE_S, places_s, before) - np.interp(opens_s, places_s, before)
    fading = 1.0 - 0.05 * times_s / times_s[-1]
    return times_s, y_px, 1e6 * collected * fading * (1.0 + noise * rng.normal(size=len(y_px)))


@pytest.mark.parametrize("row_time_us", [10.0, 15.0, -12.0])
@pytest.mark.parametrize(("delay_s", "pulse_s"), [(0.0, EXPOSURE_S), (6e-3, 4e-3), (0.0, 6e-3)])
def test_the_row_time_is_that_of_the_run(row_time_us: float, delay_s: float, pulse_s: float) -> None:
    run = pulsed_run(1e-6 * row_time_us, delay_s, pulse_s)
    found = fit_row_time_of_pulses(*run, ROWS, EXPOSURE_S, pulse_s, delay_s)
    assert found.row_time_s == pytest.approx(1e-6 * row_time_us, rel=0.005)
    assert 0.5 * 0.005 < found.scatter < 2 * 0.005
    assert found.u_row_time_s < 0.1e-6 * abs(row_time_us)
    pulls = np.array(found.off) / np.array(found.u_off)
    assert np.abs(pulls).max() < 4.5
    assert found.rows_px[0] < 100
    assert found.rows_px[-1] > 380


def test_the_ramp_is_by_how_much_the_darkest_row_is_darker() -> None:
    run = pulsed_run(1e-5, 0.0, EXPOSURE_S)
    open_s = EXPOSURE_S - 1e-5 * run[1]
    found = fit_row_time_of_pulses(*run, ROWS, EXPOSURE_S, EXPOSURE_S, 0.0)
    assert found.ramp == pytest.approx(1 - open_s.min() / open_s.max(), rel=0.01)


def test_a_pulse_that_all_rows_see_says_nothing() -> None:
    run = pulsed_run(1e-5, 5e-3, 1e-3)
    with pytest.raises(DataError, match=r"equally bright in all rows .* laser\.pulse_delay_us to 0"):
        fit_row_time_of_pulses(*run, ROWS, EXPOSURE_S, 1e-3, 5e-3)


def test_a_spot_that_stays_in_its_row_is_refused() -> None:
    times_s, y_px, light = pulsed_run(1e-5, 0.0, EXPOSURE_S)
    with pytest.raises(DataError, match="at least 20 are needed"):
        fit_row_time_of_pulses(times_s, 240 + 0.01 * y_px, light, ROWS, EXPOSURE_S, EXPOSURE_S)
