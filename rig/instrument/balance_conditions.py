"""The balance of a run, or of one moment of it, held against the limits of `rig balance`."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from processing.balance import Balance, BalanceLimits, Fault, find_faults
from processing.deflections import DeflectionUnit
from rig.presentation import Verdict, percent, with_uncertainty

PLANE_OF_SWING: Final = "plane of swing"
"""Name of the condition of the rotation."""
_SURELY: Final = 2.0
"""Standard uncertainties beyond a limit, where one period alone is judged."""


class _Condition(NamedTuple):
    """Name of a condition, what is wrong where it fails, and what to do."""

    name: str
    reason: str
    remedy: str


_OF_FAULTS: Final[Mapping[str, _Condition]] = {
    "transverse motion": _Condition(
        "transverse motion", "the start pushed it sideways", "release along Y; rig balance"
    ),
    "leakage": _Condition(
        "ellipticity", "the slow mode draws an ellipse", "set the balance with rig balance"
    ),
    "spin": _Condition(
        PLANE_OF_SWING,
        "it turns about the vertical",
        "let the pendulum settle before the release; rig balance shows the rotation",
    ),
    "rest position X": _Condition("tilt at rest, X", "it rests askew", "set the balance with rig balance"),
    "rest position Y": _Condition("tilt at rest, Y", "it rests askew", "set the balance with rig balance"),
}
"""Faults of a balance that are conditions of a run. The direction of the line is the camera's."""

BALANCE_CONDITIONS: Final = frozenset(one.name for one in _OF_FAULTS.values())
"""Names of the conditions of a run that its balance decides."""


def balance_verdicts(balance: Balance | None, limits: BalanceLimits) -> list[Verdict]:
    """One verdict for each quantity that is known, which has a limit in the unit of the deflections."""
    return [] if balance is None else _verdicts(balance, limits, 0.0)


def balance_failures(balance: Balance, limits: BalanceLimits) -> list[str]:
    """Name, value and limit of each condition that the balance of one moment surely does not meet."""
    return [
        f"{one.name} {one.measured}, limit {one.limit}"
        for one in _verdicts(balance, limits, _SURELY)
        if not one.ok
    ]


def _verdicts(balance: Balance, limits: BalanceLimits, beyond_u: float) -> list[Verdict]:
    if balance.unit is not DeflectionUnit.RAD:
        # ratios and angles need no lever; the limits of the rest position are in arcsec
        balance = replace(balance, unit=DeflectionUnit.RAD, rest_x=math.nan, rest_y=math.nan)
    return [
        _verdict(_OF_FAULTS[fault.name], fault, beyond_u)
        for fault in find_faults(balance, (math.nan, math.nan), limits)
        if fault.is_known and fault.name in _OF_FAULTS
    ]


def _verdict(condition: _Condition, fault: Fault, beyond_u: float) -> Verdict:
    ok = fault.ok or not abs(fault.value) - beyond_u * fault.u_value > fault.limit
    if fault.unit:
        measured = f"{with_uncertainty(fault.value, fault.u_value, signed=True)} {fault.unit}"
        limit = f"{fault.limit:g} {fault.unit}"
    else:
        measured, limit = percent(abs(fault.value)), f"{100 * fault.limit:g} %"
    return Verdict(
        condition.name,
        ok,
        "" if ok else condition.reason,
        "" if ok else condition.remedy,
        measured=measured,
        limit=limit,
    )
