"""Numbers of the desk have the digits that matter: those of the limit, or of the uncertainty."""

import math

import pytest

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
