"""An error that is fixed on the sensor is found, also of a bent scale, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from processing.position_map.fixed_pattern import Splines
from processing.units import ARCSEC_RAD
from tests.processing.position_map.runs import NOISE, PX, Floats, fringes, nothing, run, searched


def without_trend(place: Floats, error: Floats) -> Floats:
    """Beside a constant and a scale, which no free swing shows."""
    return error - np.polyval(np.polyfit(place, error, 1), place)


def test_fringes_are_found() -> None:
    one = run(fringes, seed=1)
    found = searched(one)
    place = np.linspace(-235.0, 235.0, 400) * PX
    off = without_trend(place, found.error(place) - fringes(place, place))
    assert np.std(off) < 0.1 * np.std(fringes(place, place))
    assert 0.5 < np.sqrt(np.mean((off / found.u_error(place)) ** 2)) < 2.0
    corrected = found.corrected(one.deflections).y - one.deflections.y
    assert np.allclose(corrected, -fringes(corrected, one.deflections.y), atol=0.02 * PX)
    assert 0.7 < found.noise_scale < 1.4


def test_nothing_is_found_where_nothing_is() -> None:
    assert searched(run(nothing, 0)) is None


def test_a_time_that_depends_on_the_place_is_no_error_of_place() -> None:
    """Rows exposed in turn, 2 us apart: the error has the sign of the velocity."""

    def late(time_s: Floats, place: Floats) -> Floats:
        return np.interp(time_s + 2e-6 * place / PX, time_s, place) - place

    assert np.abs(late(np.arange(200) / 50.0, 250 * PX * np.cos(np.arange(200) / 33.0))).max() > 10 * NOISE
    assert searched(run(late, seed=1)) is None


@pytest.mark.parametrize(("ratio", "shown"), [(2.956, False), (5.0, True)])
def test_a_fast_mode_is_no_error_of_place(ratio: float, shown: bool) -> None:
    def seen(time_s: Floats) -> Floats:
        return np.cos(2 * np.pi * ratio * time_s / 4.071 + 0.3) * np.exp(-time_s / 400) * ARCSEC_RAD

    fast = (lambda t: 4.0 * seen(t)) if shown else None
    assert searched(run(lambda time_s, _: 0.2 * seen(time_s), seed=1, fast=fast)) is None


def test_fringes_are_found_beside_a_fast_mode() -> None:
    def seen(time_s: Floats) -> Floats:
        return np.cos(2 * np.pi * time_s / 0.83 + 0.3) * np.exp(-time_s / 400) * ARCSEC_RAD

    one = run(lambda t, place: fringes(t, place) + 0.2 * seen(t), seed=2, fast=lambda t: 4.0 * seen(t))
    found = searched(one)
    place = np.linspace(-235.0, 235.0, 400) * PX
    off = without_trend(place, found.error(place) - fringes(place, place))
    assert np.std(off) < 0.15 * np.std(fringes(place, place))


def test_splines_add_up_to_one_and_reproduce_a_line() -> None:
    splines = Splines.over(-3.0, 5.0, 23)
    place = np.linspace(-3.0, 5.0, 50)
    values = splines.matrix(place)
    assert np.allclose(values.sum(axis=1), 1.0)
    assert np.allclose(values @ splines.centres, place)
    assert np.allclose(splines.matrix(np.array([-9.0, 9.0])), values[[0, -1]])


def bent(time_s: Floats, place: Floats) -> Floats:
    """Of a position-sensitive diode whose scale is by 1 % another one at the end of the swing."""
    return np.asarray(0.01 * place * (place / (124.0 * ARCSEC_RAD)) ** 2)


def test_a_map_takes_its_errors_off_and_the_scale_it_leaves_open_is_as_uncertain_as_wrong() -> None:
    one = run(bent, seed=1)
    found = searched(one)
    true = np.linspace(*found.limits, 500)
    few = one.deflections[:500]
    measured = replace(few, y=true + found.error(true))
    assert np.max(np.abs(found.corrected(measured).y - true)) < 1e-5 * ARCSEC_RAD
    weight = true / (true @ true)
    matrix = found.splines.matrix(true)
    u_scale = float(np.sqrt(weight @ matrix @ found.covariance @ matrix.T @ weight))
    wrong = float(weight @ (found.error(true) - bent(true, true)))
    assert abs(wrong) < 2.5 * u_scale
