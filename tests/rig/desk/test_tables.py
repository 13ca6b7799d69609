"""Numbers of the desk have the digits that matter: those of the limit, or of the uncertainty."""

import math

import pytest

from rig.desk.panels.balance import fault_bars
from rig.desk.tables import judged_number


@pytest.mark.parametrize(
    ("value", "u", "limit", "shown"),
    [
        (-29.93581, 0.00044, 10.0, "−29.9"),
        (3.21, 0.4, 10.0, "+3.21 ± 0.40"),
        (0.0004321, 1e-6, 0.002, "+0.00043"),
        (120.4, 0.01, 200.0, "+120"),
        (math.nan, 0.1, 10.0, "not determined"),
    ],
)
def test_digits_beside_a_limit(value: float, u: float, limit: float, shown: str) -> None:
    assert judged_number(value, u, limit) == shown


def test_a_fraction_of_the_balance_is_in_per_cent_as_its_limit_is() -> None:
    fault = {"name": "leakage", "value": 0.0056707, "u_value": 1.8e-6, "limit": 0.01, "unit": "", "ok": True}
    unknown = {**fault, "value": None, "u_value": None, "ok": None}
    bars = fault_bars([{**fault, "meaning": ""}, {**unknown, "meaning": ""}], [unknown, fault])
    assert [(bar.shown, bar.note) for bar in bars] == [
        ("go +0.57 %", "limit 1 %; before: not known"),
        ("? not known", "limit 1 %; before: +0.57 %"),
    ]
