"""The coordinates of the fit are another way to write the parameters, with and without drag and adhesion."""

import math

import numpy as np
import pytest

from processing.contact.coordinates import Coordinates
from processing.contact.laws import PAPER
from processing.swing import TurningPoints
from tests.processing.fit.decays import ARCSEC, decay, paper_pair

VALUES = {
    "b": 7.961e-4,
    "p": 0.85,
    "c": 6.601e-9,
    "n": 0.461,
    "period0_s": 4.049,
    "gamma_pa": 95.46e6,
    "drag_s": 3e-5,
    "initial_amplitude_rad": 124 * ARCSEC,
    "start_time_s": 0.3,
}


@pytest.fixture(scope="module")
def points() -> TurningPoints:
    return decay(*paper_pair("steel"), noise_arcsec=0.005, seed=1)


def columns_of(points: TurningPoints, drag: bool) -> Coordinates:
    return PAPER.coordinates(points, paper_pair("steel")[1], PAPER.fit_names(drag=drag))


EVERY = pytest.mark.parametrize("drag", [False, True])


@EVERY
def test_columns_of_others_stand_before_those_of_the_law(points: TurningPoints, drag: bool) -> None:
    """As the gains of a seismometer; the parameters know nothing of them."""
    names, pendulum = PAPER.fit_names(drag=drag), paper_pair("steel")[1]
    own, both = columns_of(points, drag), PAPER.coordinates(points, pendulum, names, (3.0, -4.0))
    start = both.starts(points)[0][0]
    np.testing.assert_array_equal(start, [3.0, -4.0, *own.starts(points)[0][0]])
    np.testing.assert_array_equal(both.lower, [-np.inf, -np.inf, *own.lower])
    np.testing.assert_array_equal(both.upper, [np.inf, np.inf, *own.upper])
    (values, by), (expected, by_own) = both.physical(start), own.physical(start[2:])
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(by, np.column_stack([np.zeros((len(names), 2)), by_own]))
    for name in names:
        held = own.held(name)
        assert both.held(name) == (held.column + 2, held.keeps_sign)
    assert both.valley == (2 if drag else None)
    # ln b, and n
    start[[2, 2 + own.held("n").column]] = own.lower[[0, own.held("n").column]]
    assert both.at_limit(start) == own.at_limit(start[2:])
    assert {"b", "n"} <= set(both.at_limit(start))


def test_adhesion_weakens_the_restoring_moment(points: TurningPoints) -> None:
    """The column of T0 is the period at the reference amplitude: adhesion makes it longer."""
    columns = columns_of(points, drag=False)
    with_it, without = (columns.from_physical({**VALUES, "gamma_pa": gamma}) for gamma in (95.46e6, 0.0))
    assert without[-2] == pytest.approx(VALUES["period0_s"])
    assert with_it[-2] > without[-2]
    # friction is then a larger part of what is left of the stiffness
    assert with_it[2] / without[2] == pytest.approx((with_it[-2] / without[-2]) ** 2, rel=1e-9)
    assert with_it[0] > without[0]


def test_drag_and_friction_cannot_cancel_each_other_without_end(points: TurningPoints) -> None:
    """With p near 1, b and drag have the same effect: b stays within some times the loss that was seen."""
    loss = math.log(points.amplitude[0] / points.amplitude[-1]) / (points.index[-1] - points.index[0])
    plain, dragged = columns_of(points, drag=False), columns_of(points, drag=True)
    seen = [columns.from_physical(VALUES)[0] for columns in (plain, dragged)]
    assert seen[0] < plain.upper[0]
    assert seen[1] < dragged.upper[0] < math.log(10 * loss) < plain.upper[0]
    # p is a column only without drag
    assert np.isinf(dragged.lower[1])
    assert plain.lower[1] < 0 < 1 < plain.upper[1] < 10


@EVERY
def test_a_parameter_at_the_end_of_its_range_is_named(points: TurningPoints, drag: bool) -> None:
    columns = columns_of(points, drag)
    assert list(columns.at_limit(columns.from_physical(VALUES))) == []
    for name, value in (("n", 2e-5), ("n", 4.99999), ("p", -0.49999), ("p", 4.99999)):
        # far from the reference amplitude b is unlike any that was searched
        limited = columns.at_limit(columns.from_physical({**VALUES, "gamma_pa": 1.0, name: value}))
        assert set(limited) - {"b"} == {name}
    # T is longer by 1/sqrt(q), and adhesion takes 1 - q of the stiffness: it may leave an eighteenth of it
    period_s = columns_of(points, drag=False).from_physical(VALUES)[-2]
    taken = 1 - (VALUES["period0_s"] / period_s) ** 2
    for times, named in ((17.5, False), (18.5, True)):
        limited = columns.at_limit(
            columns.from_physical({**VALUES, "gamma_pa": VALUES["gamma_pa"] * (1 - 1 / times) / taken})
        )
        assert ("gamma_pa" in limited) is named
    at = columns.from_physical(VALUES)
    at[0] = columns.upper[0]
    at[4] = 0.0  # without adhesion the rate of loss is its own column
    assert "b" in columns.at_limit(at)


@EVERY
def test_start_values_are_near_the_truth(points: TurningPoints, drag: bool) -> None:
    columns = columns_of(points, drag)
    first = columns.starts(points)[0][0]
    values = dict(zip(PAPER.fit_names(drag=drag), columns.physical(first)[0].tolist(), strict=True))
    assert values["period0_s"] == pytest.approx(VALUES["period0_s"], rel=1e-3)
    assert values["initial_amplitude_rad"] == pytest.approx(points.amplitude[0], rel=0.05)
    assert values["start_time_s"] == pytest.approx(points.time_s[0])
    # the loss at the reference amplitude, by all that takes part in it
    r = columns.reference

    def loss(v: dict[str, float]) -> float:
        return (
            2 * v["b"] * r ** v["p"] / r + 2 * v["c"] / r + math.pi**2 / v["period0_s"] * v.get("drag_s", 0.0)
        )

    true = {name: VALUES[name] for name in ("b", "p", "c", "period0_s")}
    assert loss(values) == pytest.approx(loss(true), rel=0.15)
    slower = columns.physical(columns.starts(points)[0][-1])[0]
    assert slower[0] < values["b"]
