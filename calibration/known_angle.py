"""Check of the light lever's scale by repeated measurement of known tilts, before and after a series."""

import math
from dataclasses import dataclass

from calibration.lever_fit import LadderFit
from calibration.light_lever import Lever

_COVERAGE = 2.0


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Scale now over the lever's, with the uncertainty of now alone.

    `moved` where it differs from 1 by more than twice the uncertainty of both together (95 %).
    """

    ratio: float
    u_ratio: float
    u_both: float
    moved: bool


def check_scale(lever: Lever, fit: LadderFit) -> ScaleCheck:
    """Scale of known tilts against the lever that is in use."""
    ratio = fit.scale * lever.pixel_pitch_m / lever.arm_m
    u_ratio = fit.u_scale / fit.scale * ratio
    u_both = math.hypot(u_ratio, lever.u_scale_relative)
    return ScaleCheck(ratio, u_ratio, u_both, abs(ratio - 1.0) > _COVERAGE * u_both)


def moved_between(
    before: tuple[float, float], after: tuple[float, float], u_common_relative: float = 0.0
) -> tuple[float, float, bool]:
    """Change of the scale from one check to the next, its uncertainty, and whether it counts.

    Each check is (ratio, standard uncertainty). `u_common_relative` is what both have from the
    reference itself, which the change does not contain.
    """
    own = [math.sqrt(max(u**2 - (ratio * u_common_relative) ** 2, 0.0)) for ratio, u in (before, after)]
    change = after[0] - before[0]
    u_change = math.hypot(*own)
    return change, u_change, abs(change) > _COVERAGE * u_change
