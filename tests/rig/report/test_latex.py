"""Numbers as text (digits by the uncertainty, powers of ten, what is not determined) and tables for LaTeX."""

import math
from decimal import Context, Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.number_text import (
    decimals,
    judged_number,
    plain,
    rounded,
    signed,
    signed_percent,
    with_uncertainty,
)
from processing.units import _OTHERS, _PREFIXABLE
from rig.interruption import ascii_text
from rig.report.drawing import break_at_gaps, envelope, thinned_indices
from rig.terminal import Table, latex_table
from rig.terminal.latex import _UNITS


def lines_of(*row: str, head: tuple[str, ...] = ("", "value", "unit")) -> list[str]:
    table = Table("t", "Title", head, [row])
    return latex_table(table).splitlines()


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        ("(3.7333 ± 0.0030) × 10⁻³", r"\num{3.7333 +- 0.0030 e-3}"),
        ("−1234 ± 12", r"\num{-1234 +- 12}"),
        ("0.09200 ± 0.00020", r"\num{0.09200 +- 0.00020}"),
        ("5.23 × 10⁻⁴", r"\num{5.23 e-4}"),
        ("4.071", r"\num{4.071}"),
        ("< 3.3 × 10⁻⁸ (95 %)", r"$<$ 3.3 $\times 10^{-8}$ (95 \%)"),
        ("γ and T₀ of A_b & c", r"$\gamma$ and $T_{0}$ of A\_b \& c"),
        ("σ (Table 2's form)", r"$\sigma$ (Table 2's form)"),
        ("4Aₜ", r"4$A_{t}$"),
        ("p̄", r"$\bar{p}$"),
    ],
)
def test_a_cell(cell: str, text: str) -> None:
    assert lines_of("x", cell, "")[8] == rf"x & {text} &  \\"


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("MPa", r"\unit{\mega\pascal}"),
        ("mJ/m²", r"\unit{\milli\joule\metre\tothe{-2}}"),
        ("rad⁻ᵖ", r"\unit{rad^{-p}}"),
        ("%", r"\unit{\percent}"),
        # siunitx knows no \degreecelsius and no \ppm
        ("°C", r"\unit{\degreeCelsius}"),
        ("ppm", "ppm"),
        ("mas/s", r"\unit{\milli\arcsecond\second\tothe{-1}}"),
        # its px was left out
        ("px/min", "px/min"),
        # of a table: the rest of the line was a comment
        ("% FS_x", r"\% FS\_x"),
        ("", ""),
    ],
)
def test_a_unit(unit: str, text: str) -> None:
    assert lines_of("x", "1", unit)[8] == rf"x & \num{{1}} & {text} \\"


def test_every_unit_of_the_table_has_a_name_or_is_a_count() -> None:
    assert {*_OTHERS, *_PREFIXABLE} == {*_UNITS, "px", "DN", "e", "1", "ppm"}


def test_a_heading_names_its_unit() -> None:
    found = lines_of("1", "2", head=("α / arcsec", "σ / (mJ/m²)"))[6]
    assert found == r"$\alpha$ / \unit{\arcsecond} & $\sigma$ / \unit{\milli\joule\metre\tothe{-2}} \\"


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (3.73315e-3, 1.0e-7, "(3.73315 ± 0.00010) × 10⁻³"),
        (-1.24e-8, 8.2e-9, "(−1.24 ± 0.82) × 10⁻⁸"),
        (28.9, 0.0996, "28.90 ± 0.10"),
        (1.0, math.inf, "1.0000"),
        (math.nan, 1.0, "not determined"),
        (-1234.5, 12.3, "−1234 ± 12"),
        (12345.0, 120.0, "(1.234 ± 0.012) × 10⁴"),
        (9.99996e-4, 1e-6, "(1.0000 ± 0.0010) × 10⁻³"),
        (-1e-5, 0.5, "0.00 ± 0.50"),
        (0.0, 99.6, "(0.0 ± 1.0) × 10²"),
    ],
)
def test_two_digits_of_the_uncertainty(value: float, u: float, text: str) -> None:
    assert with_uncertainty(value, u) == text


@pytest.mark.parametrize(
    ("value", "u", "limit", "shown"),
    [
        (-29.93581, 0.00044, 10.0, "−29.9"),
        (3.21, 0.4, 10.0, "+3.21 ± 0.40"),
        (0.0004321, 1e-6, 0.002, "+0.00043"),
        (-0.0004, 1e-6, 10.0, "+0.0"),
        (120.4, 0.01, 200.0, "+120"),
        (math.nan, 0.1, 10.0, "not determined"),
    ],
)
def test_digits_beside_a_limit(value: float, u: float, limit: float, shown: str) -> None:
    assert judged_number(value, u, limit) == shown


def test_a_sign_where_the_direction_matters_and_none_of_what_rounds_to_zero() -> None:
    assert with_uncertainty(2.0, 0.0123, signed=True) == "+2.000 ± 0.012"
    assert with_uncertainty(-2e-7, 1e-9, signed=True) == "(−2.000 ± 0.010) × 10⁻⁷"
    assert with_uncertainty(2.0, math.nan, signed=True) == "+2.0000"
    shown = [signed(value) for value in (0.12, -0.0052, 3e-6, 0.0, -14.2)]
    assert shown == ["+0.12", "−0.0052", "+3.0 × 10⁻⁶", "0", "−14"]
    shown = [decimals(-0.04, 1), decimals(-12.0, 1), decimals(-0.04, 1, sign=True)]
    assert shown == ["0.0", "−12.0", "+0.0"]


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.0025, "+0.25 %"), (-12.3, "−1230 %"), (-4.3e-8, "−4.3 × 10⁻⁶ %"), (-0.0, "+0 %")],
)
def test_a_difference_has_its_sign_and_no_exponent_of_programs(fraction: float, text: str) -> None:
    assert signed_percent(fraction) == text


def test_a_terminal_without_the_characters_gets_them_spelled_out() -> None:
    assert ascii_text(with_uncertainty(-3.73315e-3, 1e-7)) == "(-3.73315 +- 0.00010) x 10^-3"
    assert ascii_text("γ / MPa, b / rad⁻ᵖ, 5°") == "gamma / MPa, b / rad^-p, 5 deg"


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(FINITE, FINITE.filter(lambda u: u > 0))
def test_value_and_uncertainty_end_at_the_second_digit_of_the_uncertainty(value: float, u: float) -> None:
    value_text, u_text, exponent = rounded(value, u)
    shown, u_shown = (
        Decimal(text.replace("−", "-")).scaleb(exponent, Context(prec=1000)) for text in (value_text, u_text)
    )
    assert len(u_shown.as_tuple().digits) == 2
    # both end at the same place, and are the nearest numbers that do
    assert shown.as_tuple().exponent == u_shown.as_tuple().exponent
    step = Decimal((0, (1,), int(u_shown.as_tuple().exponent)))
    with localcontext(prec=1000):
        assert abs(shown - Decimal(repr(value))) <= step / 2
        assert abs(u_shown - Decimal(repr(u))) <= step / 2
    assert (
        with_uncertainty(value, u)
        .translate(str.maketrans("", "", "()"))
        .startswith(f"{value_text} ± {u_text}")
    )


@given(st.floats(-1e12, 1e12).filter(lambda v: abs(v) > 1e-12), st.integers(2, 8))
def test_a_plain_number_keeps_its_digits(value: float, digits: int) -> None:
    text = plain(value, digits).replace("−", "-")
    if " × 10" in text:
        mantissa, _, power = text.partition(" × 10")
        exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
        text = f"{mantissa}e{exponent}"
    assert float(text) == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - digits))


def test_an_envelope_holds_every_extreme() -> None:
    x = np.linspace(0, 100, 5003)
    y = np.sin(7 * x) * np.exp(-0.02 * x)
    y[1234] = 5.0
    y[77] = np.nan
    at, low, high = envelope(x, y, 60)
    assert len(at) == 60
    assert high.max() == 5.0
    assert low.min() == np.nanmin(y)
    assert np.all(low <= high)


def test_lines_end_at_gaps_and_bands_too() -> None:
    x = np.delete(np.arange(0, 100, 0.01), np.arange(3000, 5000))
    at, y = break_at_gaps(x, np.cos(x))
    (gap,) = np.flatnonzero(np.isnan(y))
    assert at[gap] == pytest.approx(40, abs=0.02)
    assert np.array_equal(np.delete(y, gap), np.cos(x))
    wide, low, high = break_at_gaps(*envelope(x, np.cos(x), 300))
    assert np.isnan(low).sum() == np.isnan(high).sum() == 1
    assert 30 < wide[np.isnan(low)][0] < 50
    assert len(break_at_gaps(x[:3], x[:3])[0]) == 3


def test_thinning_keeps_both_ends() -> None:
    kept = thinned_indices(1001, 100)
    assert kept[0] == 0
    assert kept[-1] == 1000
    assert len(kept) == 100
    assert thinned_indices(5, 100).tolist() == [0, 1, 2, 3, 4]
