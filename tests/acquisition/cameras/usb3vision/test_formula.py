"""Formulas of camera descriptions: numbers, precedence, errors."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.cameras.usb3vision.genapi.formula import Formula, FormulaError
from acquisition.cameras.usb3vision.genapi.operators import Number


def value_of(text: str, whole: bool = False, **variables: Number) -> Number:
    return Formula(text, whole=whole, variables=frozenset(variables), owner="Feature")(variables)


@pytest.mark.parametrize(
    ("text", "whole", "real"),
    [
        ("7/2", 3, 3.5),
        ("-7/2", -3, -3.5),
        ("-7%3", -1, -1.0),
        ("2**10", 1024, 1024.0),
        ("2**-1", 0, 0.5),
        ("2**3**2", 64, 64.0),
        ("-2**2", 4, 4.0),
        ("~5", -6, -6.0),
        ("1+1<<2", 5, 5.0),
        ("2*3|8", 22, 22.0),
        ("1|2**3", 27, 27.0),
        ("1&&2=2", 0, 0.0),
        ("0?2:0?4:5", 5, 5.0),
        ("(0x10 <> 16) ? 1 : 3", 3, 3.0),
        ("5>3&&2>1", 0, 0.0),
        ("(5 > 3) && (2 <= 2)", 1, 1.0),
        ("1<<70", 64, 64.0),
        ("10-4-3", 3, 3.0),
    ],
)
def test_operators_as_the_reference_has_them(text: str, whole: int, real: float) -> None:
    assert value_of(text, whole=True) == whole
    assert value_of(text) == real


def test_functions() -> None:
    assert value_of("ROUND(2.5)") == 3
    assert value_of("ROUND(-2.5)") == -3
    assert value_of("ROUND(2.349, 1)") == 2.3
    assert value_of("TRUNC(-2.7) + FLOOR(-2.5) + CEIL(2.1)") == -2
    assert value_of("LN(EXP(1)) + LG(100) + SQRT(16)") == pytest.approx(7)
    assert value_of("abs(-3) + SGN(-2) + NEG(1)") == 1
    assert value_of("E + PI") == pytest.approx(math.e + math.pi)
    assert math.isnan(value_of("SQRT(-1)"))


@pytest.mark.parametrize("text", ["1/X", "1%X", "X/X", "(X = 0) ? 1/X : 2"])
@pytest.mark.parametrize("whole", [True, False])
def test_division_by_zero_names_formula_and_values(text: str, whole: bool) -> None:
    with pytest.raises(FormulaError, match=r"Feature.*divides by zero with X = 0"):
        value_of(text, whole, X=0)


def test_a_guarded_division_is_not_carried_out() -> None:
    assert value_of("(X = 0) ? 7 : 1/X", X=0) == 7
    assert value_of("(X = 0) || (1/X > 2)", X=0) == 1


@pytest.mark.parametrize(
    "text", ["", "1 2", "(1", "1)", "1 +", "FOO", "1?2", "SIN(1,2)", "import os", "__import__", "$", "X(2)"]
)
def test_malformed_formulas_are_refused(text: str) -> None:
    with pytest.raises(FormulaError, match="Feature"):
        value_of(text, X=1)


def test_deep_brackets_are_refused_without_a_crash() -> None:
    with pytest.raises(FormulaError, match="brackets"):
        value_of("(" * 5000 + "1" + ")" * 5000)


@given(st.text("0123456789xXAB.+-*/%&|^~=<>?:(), ", max_size=40))
def test_any_text_gives_a_number_or_a_formula_error(text: str) -> None:
    for whole in (True, False):
        try:
            result = value_of(text, whole, A=3, B=0)
        except FormulaError:
            continue
        assert isinstance(result, int if whole else float)


@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1))
def test_whole_numbers_stay_within_64_bits(a: int, b: int) -> None:
    for operator in ("+", "-", "*", "**", "<<", ">>", "&", "|", "^"):
        assert -(2**63) <= value_of(f"A{operator}B", True, A=a, B=b) < 2**63
