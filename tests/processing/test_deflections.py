"""Deflections are cut, joined and shown together with their unit."""

import numpy as np
import pytest

from processing.deflections import Deflections, DeflectionUnit, joined, no_deflections, slow_deflections
from processing.units import ARCSEC_RAD


def some(unit: DeflectionUnit, count: int = 5) -> Deflections:
    values = np.arange(count, dtype=np.float64)
    return Deflections(np.arange(count) * 1_000_000_000, values, 2 * values, values + 1, values + 2, unit)


def test_a_value_is_shown_in_arcsec_or_in_px_and_never_in_the_other() -> None:
    angles, places = some(DeflectionUnit.RAD), some(DeflectionUnit.PX)
    assert (angles.unit.shown, places.unit.shown) == ("arcsec", "px")
    np.testing.assert_array_equal(angles.shown_y, angles.y / ARCSEC_RAD)
    np.testing.assert_array_equal(places.shown_x, places.x)


def test_rows_are_taken_from_all_arrays_and_the_unit_goes_along() -> None:
    whole = some(DeflectionUnit.PX)
    late = whole.since(3_000_000_000)
    assert len(late) == 2
    assert late.unit is DeflectionUnit.PX
    np.testing.assert_array_equal(late.u_y, [5.0, 6.0])
    np.testing.assert_array_equal(late.times_s, [0.0, 1.0])
    again = joined([whole[:3], whole[3:]], DeflectionUnit.RAD)
    np.testing.assert_array_equal(again.y, whole.y)
    assert again.unit is DeflectionUnit.PX


def test_a_lost_spot_is_not_found() -> None:
    whole = some(DeflectionUnit.RAD)
    whole.x[2] = np.nan
    assert whole.found.tolist() == [True, True, False, True, True]
    assert len(whole[whole.found]) == 4


def test_angles_are_not_joined_to_pixels() -> None:
    with pytest.raises(ValueError, match="px and rad"):
        joined([some(DeflectionUnit.RAD), some(DeflectionUnit.PX)], DeflectionUnit.RAD)


def test_nothing_has_a_unit_too() -> None:
    nothing = joined([], DeflectionUnit.PX)
    assert len(nothing) == len(nothing.times_s) == 0
    assert nothing.unit is no_deflections(DeflectionUnit.PX).unit is DeflectionUnit.PX


def test_one_axis_alone() -> None:
    y = np.array([1.0, 2.0])
    slow = slow_deflections(np.array([0, 1]), y, 0.5)
    assert slow.unit is DeflectionUnit.RAD
    assert np.isnan(slow.x).all()
    assert slow.u_y.tolist() == [0.5, 0.5]
