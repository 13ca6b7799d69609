"""A balance against its limits: a moment fails only where it is surely beyond, a whole run by its value."""

import math
from typing import Any

import pytest

from processing.balance import Balance, BalanceLimits
from processing.deflections import DeflectionUnit
from rig.instrument.balance import balance_failures, balance_verdicts, run_balance_verdicts

LIMITS = BalanceLimits()
LIMIT_RAD_PER_S = math.radians(LIMITS.spin_deg_per_min) / 60.0


def turning(part_of_limit: float, u_part: float) -> Balance:
    """A balance of which only the rotation is known, in parts of its limit."""
    unknown: dict[str, Any] = dict.fromkeys(Balance.__dataclass_fields__, math.nan)
    rate = {"rotation_rad_per_s": part_of_limit * LIMIT_RAD_PER_S}
    rate |= {"u_rotation_rad_per_s": u_part * LIMIT_RAD_PER_S}
    return Balance(**{**unknown, "time_ns": 0, "unit": DeflectionUnit.RAD, **rate})


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("part", "run_ok", "moment_ok"), [(0.9, True, True), (1.1, False, True), (1.3, False, False)]
)
def test_a_rotation_near_its_limit(sign: float, part: float, run_ok: bool, moment_ok: bool) -> None:
    balance = turning(sign * part, 0.1)
    assert [one.ok for one in balance_verdicts(balance, LIMITS)] == [run_ok]
    assert (not balance_failures(balance, LIMITS)) == moment_ok


def test_a_run_says_where_it_does_not_know_whether_its_plane_turned() -> None:
    unknown = turning(math.nan, math.nan)
    for balance in (None, unknown):
        (one,) = run_balance_verdicts(balance, LIMITS)
        assert one.ok
        assert one.name == "plane of swing"
        assert "not known" in one.reason
        assert one.remedy
    assert run_balance_verdicts(turning(0.5, 0.1), LIMITS) == balance_verdicts(turning(0.5, 0.1), LIMITS)
