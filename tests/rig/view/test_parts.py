"""Parts of the view without a viewer: axes, trail, decimation, both parts of X(t), the balance, colours."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from processing.ambient import AmbientConditions
from processing.balance import Balance
from processing.contact import LAWS
from processing.deflections import DeflectionUnit
from processing.fit import DerivedQuantity, FitQuality, Work
from processing.quantity import quantities_of
from processing.units import ARCSEC_RAD
from rig.terminal import palette
from rig.terminal.quantities import (
    BALANCE_STYLES,
    balance_numbers,
    balance_style,
    balance_table,
    declaration,
    law_parameters,
    quantity,
)
from rig.view.graticule import Graticule, reach_beyond, tick_label, ticks, trajectory_graticule
from rig.view.transverse import Decimator, Trail, TransverseCurves


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_are_round_few_and_inside(low: float, span: float) -> None:
    high = low + span
    if not high > low:
        return
    places = ticks(low, high)
    # a tick is a product of doubles: it is known to a few units in the last place of the larger limit
    slack = 1e-6 * (high - low) + 8 * np.spacing(max(abs(low), abs(high)))
    assert len(places) <= 8
    assert (places >= low - slack).all()
    assert (places <= high + slack).all()


def test_tick_labels_have_the_decimals_of_their_step() -> None:
    assert [tick_label(value, 0.5) for value in (-0.5, 0.0, 1.0)] == ["−0.5", "0.0", "1.0"]
    assert [tick_label(value, 50.0) for value in (-50.0, 0.0)] == ["−50", "0"]
    assert tick_label(-1e-17, 0.1) == "0.0"


@given(st.floats(1e-3, 1e5))
def test_the_axes_reach_beyond_the_amplitude_but_not_far(amplitude: float) -> None:
    assert 1.02 * amplitude < reach_beyond(amplitude) <= 1.71 * amplitude


@pytest.mark.parametrize("amplitude", [0.0, math.nan, math.inf, -1.0])
def test_the_axes_have_a_length_without_an_amplitude(amplitude: float) -> None:
    assert reach_beyond(amplitude) == 1.0


@given(st.floats(1e-2, 1e4), st.sampled_from([1.0, 10.0]))
def test_the_trajectorys_axes_fill_the_same_part_of_the_plane(reach: float, stretch: float) -> None:
    graticule = trajectory_graticule(reach, "arcsec", stretch)
    corners = graticule.to_plane(np.array([graticule.x_low, graticule.x_high]), np.array([-reach, reach]))
    np.testing.assert_allclose(corners, [[-100, 100], [100, -100]], rtol=1e-12)


def test_a_boxs_axes_hold_every_value_and_are_not_set_by_a_few() -> None:
    x, y = np.arange(200.0), np.concatenate((np.linspace(-1, 1, 198), [1e3, np.nan]))
    whole, trimmed = (Graticule.boxed(x, y, "x", "y", trims_y=flag) for flag in (False, True))
    assert whole.inside(x, y).sum() == 199
    assert trimmed.y_high < 3
    assert trimmed.inside(x, y).sum() == 198


@given(st.lists(st.integers(1, 60), min_size=1, max_size=12))
def test_a_trail_joins_across_blocks(sizes: list[int]) -> None:
    trail = Trail()
    drawn: list[NDArray[np.float64]] = []
    first = 0
    for size in sizes:
        time_s = np.arange(first, first + size, dtype=np.float64)
        ends, strips = trail.strips(time_s, np.column_stack((time_s, -time_s)))
        assert [strip[-1][0] for strip in strips] == ends.tolist()
        drawn.extend(strips)
        first += size
    segments = [(a[0], b[0]) for strip in drawn for a, b in itertools.pairwise(strip)]
    assert segments == [(float(n), float(n + 1)) for n in range(first - 1)]


def test_a_trail_is_broken_by_a_lost_spot_at_a_blocks_edge() -> None:
    trail = Trail()
    block = np.arange(3.0)
    trail.strips(block, np.array([[0.0, 0.0], [1.0, 1.0], [np.nan, np.nan]]))
    _, strips = trail.strips(block + 3, np.array([[3.0, 3.0], [4.0, 4.0], [5.0, 5.0]]))
    assert [strip[0][0] for strip in strips] == [3.0]


@given(st.floats(1.0, 20_000.0), st.integers(0, 2**31))
def test_decimation_keeps_the_rate_and_every_flag(rate_hz: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    time_s = np.arange(2000) / rate_hz
    flags = (random.random(2000) < 0.01).astype(np.int64)
    decimator = Decimator(100.0)
    split = int(random.integers(0, 2000))
    parts = [decimator.choose(time_s[part], flags[part]) for part in (slice(split), slice(split, None))]
    chosen = np.concatenate(parts)
    assert chosen[flags != 0].all()
    unflagged = np.count_nonzero(chosen & (flags == 0))
    assert unflagged <= time_s[-1] * 100.0 + 2
    if rate_hz <= 99.0:
        assert chosen.all()


def test_the_balances_table_names_values_and_units() -> None:
    table = balance_table({"transverse_ratio": (0.0201, 0.0005), "rest_x": (-0.5, 0.01)}, unit="px")
    assert "| transverse ratio / % | 2.010 ± 0.050 |" in table
    assert "| rest X / px | −0.500 ± 0.010 |" in table


def test_the_balances_numbers_come_in_units_that_a_person_reads() -> None:
    stated = {
        "rest_x": ARCSEC_RAD,
        "u_rest_x": 0.1 * ARCSEC_RAD,
        "drift_x_per_s": ARCSEC_RAD,
        "rotation_rad_per_s": math.pi / 180,
        "period_ratio": 5.0,
        "u_period_ratio": 0.1,
    }
    fields: dict[str, Any] = dict.fromkeys(Balance.__dataclass_fields__, 0.0)
    balance = Balance(**{**fields, **stated, "time_ns": 5, "unit": DeflectionUnit.RAD})
    numbers = balance_numbers(balance)
    shown = {key: tuple(quantity(key).factor * x for x in pair) for key, pair in numbers.items()}
    assert shown["rest_x"] == pytest.approx((1.0, 0.1))
    assert shown["drift_x_per_s"] == pytest.approx((60.0, 0.0))
    assert shown["rotation_rad_per_s"] == pytest.approx((60.0, 0.0))
    assert shown["period_ratio"] == pytest.approx((5.0, 0.1))
    some = ("rest_x", "drift_x_per_s", "rotation_rad_per_s", "period_ratio")
    assert [quantity(key).unit for key in some] == ["arcsec", "arcsec/min", "deg/min", ""]
    assert [quantity(key, "px").unit for key in some] == ["px", "px/min", "deg/min", ""]
    assert quantity("rest_x", "px").factor == pytest.approx(1.0)
    assert set(shown) <= set(BALANCE_STYLES)


def test_every_number_of_a_balance_has_a_unit_and_a_place_and_an_unknown_one_a_name() -> None:
    fields = [field.name for field in dataclasses.fields(Balance)]
    numbers = {name for name in fields if f"u_{name}" in fields}
    assert numbers == set(BALANCE_STYLES)
    assert all(declaration(name) for name in numbers)
    for panel in {drawn.panel for drawn in BALANCE_STYLES.values()} - {""}:
        assert len({quantity(key).unit for key, drawn in BALANCE_STYLES.items() if drawn.panel == panel}) == 1
    assert quantity("a_new_number").label == "a new number"
    assert balance_style("a_new_number").entity == "a_new_number"


def test_the_parameters_of_every_law_are_shown_as_the_law_says() -> None:
    for law in LAWS.values():
        for parameter in law.parameters:
            assert quantity(parameter.key).symbol == parameter.symbol
    declared = [
        quantities_of(kind) for kind in (Balance, AmbientConditions, FitQuality, DerivedQuantity, Work)
    ]
    names = [*law_parameters(), *(name for one in declared for name in one)]
    assert len(set(names)) == len(names), "a key stands for one quantity"
    assert quantity("gamma_pa").text(28.7e6, 0.52e6) == "28.70 ± 0.52"
    assert quantity("initial_amplitude_rad", "px").unit == "px"


def test_the_palette_is_told_apart_by_its_lightness_or_hue() -> None:
    assert len(set(palette.SEQUENCE)) == len(palette.SEQUENCE)
    assert palette.rgba("#E69F00") == (230, 159, 0, 255)
    assert palette.curve_colour("exact fit", 3) == palette.curve_colour("exact", 0)


PERIOD_S, TURNING = 4.07, 5e-4
T_S = np.arange(0.0, 60.0, 0.01)


def leakage(time_s: np.ndarray) -> np.ndarray:
    return np.asarray(124.0 * np.cos(2.0 * np.pi * time_s / PERIOD_S) * np.sin(0.03 + TURNING * time_s))


def fast_mode(time_s: np.ndarray) -> np.ndarray:
    return np.asarray(1.2 * np.exp(-time_s / 200.0) * np.cos(2.0 * np.pi * 5.1 * time_s / PERIOD_S))


def seen(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    angle = 0.03 + TURNING * time_s
    slow, fast = 124.0 * np.cos(2.0 * np.pi * time_s / PERIOD_S), fast_mode(time_s)
    x = slow * np.sin(angle) + fast * np.cos(angle) - 30.0
    return x, slow * np.cos(angle) - fast * np.sin(angle) + 15.0


def balance(time_s: float) -> dict[str, tuple[float, float]]:
    rotation = TURNING if time_s > 16.0 else np.nan
    return {
        "line_angle_rad": (0.03 + TURNING * time_s, 1e-6),
        "rotation_rad_per_s": (rotation, 1e-6),
        "rest_x": (-30.0 * ARCSEC_RAD, 1e-9),
        "rest_y": (15.0 * ARCSEC_RAD, 1e-9),
    }


@pytest.mark.parametrize("live", [True, False], ids=["as they come", "balances first"])
def test_both_parts_are_told_apart(live: bool) -> None:
    across = TransverseCurves()
    ready_s = [PERIOD_S * (2 + k) for k in range(12)]
    if not live:
        for time_s in ready_s:
            across.balance(time_s - PERIOD_S, balance(time_s - PERIOD_S), ARCSEC_RAD)
    times, fast, leaked = [], [], []
    for block_s in np.split(T_S, 100):
        while live and ready_s and ready_s[0] < block_s[0]:
            # of the two periods before it
            middle_s = ready_s.pop(0) - PERIOD_S
            across.balance(middle_s, balance(middle_s), ARCSEC_RAD)
        parts = across.samples(block_s, *seen(block_s))
        if parts is None:
            assert live
            assert block_s[0] < 2.2 * PERIOD_S
            continue
        for column, values in zip((times, fast, leaked), parts, strict=True):
            column.append(values)
    np.testing.assert_array_equal(np.concatenate(times), T_S)
    off = np.abs(np.concatenate(fast) - fast_mode(T_S))
    # before the rotation is known the line is a period late
    assert np.max(off[T_S > 22.0]) < 0.05
    assert np.max(off) < 1.0
    np.testing.assert_allclose(np.concatenate(leaked)[T_S > 22.0], leakage(T_S)[T_S > 22.0], atol=0.05)


def test_without_a_balance_nothing_is_separated_and_little_is_kept() -> None:
    across = TransverseCurves()
    for block_s in np.split(np.arange(0.0, 600.0, 0.1), 100):
        assert across.samples(block_s, np.zeros(len(block_s)), np.zeros(len(block_s))) is None
    across.balance(700.0, balance(0.0), ARCSEC_RAD)
    found = across.samples(np.array([701.0]), np.array([-30.0]), np.array([15.0]))
    assert found is not None
    time_s, fast, _ = found
    assert len(time_s) < 300
    assert np.isnan(fast[0])
    assert fast[-1] == pytest.approx(0.0)
