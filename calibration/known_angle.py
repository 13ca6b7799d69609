"""Check of the light lever's scale by repeated measurement of known tilts, before and after a series."""

import math
from dataclasses import dataclass

from calibration.lever_fit import LadderFit
from calibration.light_lever import Lever

_COVERAGE = 2.0
"""Coverage factor of about 95 %."""


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Scale measured now divided by the scale of the calibrated lever.

    `u_ratio` is the standard uncertainty due to the present measurement alone, `u_both` includes that of the
    lever. `moved` is True if the ratio differs from 1 by more than twice `u_both`.
    """

    ratio: float
    u_ratio: float
    u_both: float
    moved: bool


def check_scale(lever: Lever, fit: LadderFit) -> ScaleCheck:
    """Compare the scale found with known tilts with that of the lever in use."""
    ratio = fit.scale * lever.pixel_pitch_m / lever.arm_m
    u_ratio = fit.u_scale / fit.scale * ratio
    u_both = math.hypot(u_ratio, lever.u_scale_relative)
    return ScaleCheck(ratio, u_ratio, u_both, abs(ratio - 1.0) > _COVERAGE * u_both)


def moved_between(
    before: tuple[float, float], after: tuple[float, float], u_common_relative: float = 0.0
) -> tuple[float, float, bool]:
    """Change of the scale from one check to the next.

    Parameters
    ----------
    before, after
        Ratio of each check and its standard uncertainty (`ScaleCheck.ratio`, `ScaleCheck.u_ratio`).
    u_common_relative
        Relative standard uncertainty of the reference, which both checks share. It cancels in the change
        and is subtracted from the uncertainties.

    Returns
    -------
    change, u_change, moved
        The change of the ratio, its standard uncertainty, and whether it exceeds twice that.
    """
    own = [math.sqrt(max(u**2 - (ratio * u_common_relative) ** 2, 0.0)) for ratio, u in (before, after)]
    change = after[0] - before[0]
    u_change = math.hypot(*own)
    return change, u_change, abs(change) > _COVERAGE * u_change
