"""Light lever from reference data, a ladder (sequence) of known tilts, or of known shifts of the sensor."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.ladder import (
    SKEW_PRIOR_STD,
    LadderSteps,
    approach_directions,
    check_steps,
    ladder_notes,
    leave_one_out,
    scale_posterior,
    solve_ladder,
    two_sided_approach,
)
from calibration.light_lever import Lever
from processing.arrays import Floats
from processing.errors import DataError
from processing.number_text import with_uncertainty
from processing.units import ARCSEC_RAD

_LINEARITY_P_VALUE = 0.01
"""Probability of a skew of this size for a linear ladder, below which the skew is taken as real."""
_MIN_SCALE_SIGMA = 5.0
"""Scale over its standard uncertainty, below which the spot does not follow the reference."""
_REPORTED_HYSTERESIS_SIGMA = 3.0
"""Hysteresis over its standard uncertainty, above which it is reported."""
_MAX_SCALE_CHANGE = 3.5
"""Change of the scale without one step, over its standard uncertainty, above which the step is reported."""
_MAX_U_SKEW = 0.1
"""Uncertainty of the skew above which a note is given: a skew of this size shifts the fitted friction and
period of a simulated rig with little noise by about their standard uncertainty, one of 0.03 by a tenth of it.
"""
_COVERAGE = 2.0
"""Coverage factor of about 95 %."""


@dataclass(frozen=True, slots=True)
class LadderFit:
    """Result of the fit of a ladder (regression with errors in both variables).

    The model is ``spot = origin + scale (t + skew t^2) direction``, where t is the tangent of twice the tilt,
    or the shift in m. `notes` are remarks for the user.
    """

    kind: Literal["tilt", "shift"]
    scale: float
    """Scale at t = 0 in px per unit of t, the mean over all models (`scale_posterior`)."""
    u_scale: float
    scale_dof: float
    """Degrees of freedom of `u_scale`: infinite if it follows from the stated uncertainties of the steps."""
    origin_px: tuple[float, float]
    u_origin_px: tuple[float, float]
    direction_rad: float
    """Direction of positive t, from the sensor's upward vertical towards +x."""
    u_direction_rad: float
    skew: float
    """Skew that was fitted for the test of linearity."""
    u_skew: float
    chance_if_linear: float
    """Probability of a skew at least as large if the true one is 0."""
    nonlinear: bool
    """Whether the skew is taken as real; only then origin, direction and hysteresis are fitted with it."""
    cubic: float
    """Cubic part at the ladder's end, relative to the displacement there."""
    u_cubic: float
    hysteresis: float
    """Difference of settings approached from below and from above, in rad or m; NaN if not fitted."""
    u_hysteresis: float
    chi2: float
    dof: int
    leave_one_out: Floats
    """Change (n,) of the scale without each step, over the change's standard uncertainty."""
    residual_px: Floats
    """Positions (n, 2) minus those of the fitted ladder at the stated settings."""
    notes: tuple[str, ...]


def fit_ladder(
    steps: LadderSteps, kind: Literal["tilt", "shift"], *, u_reference_relative: float = 0.0
) -> LadderFit:
    """Fit scale, origin and direction to a ladder.

    Parameters
    ----------
    steps
        The measurements.
    kind
        Whether the references are tilts of the pendulum (rad) or shifts of the sensor (m).
    u_reference_relative
        Relative standard uncertainty of the scale of the reference, common to all settings. It enlarges
        `u_scale` only.

    Raises
    ------
    DataError
        Fewer than five steps or three different settings, a value that is NaN, tilts of one sign,
        uncertainties that are not positive, or a spot that does not follow the reference.

    Notes
    -----
    Weighted least squares along and across the motion of the spot. The uncertainties are enlarged by the
    Birge ratio if the scatter is improbably large (`birge_ratio`), along and across the motion each by its
    own: an error of the references moves the spot along only.
    """
    from scipy.special import chdtrc, fdtrc

    check_steps(steps, kind)
    approach = two_sided_approach(steps.reference, approach_directions(steps.reference))
    linear = solve_ladder(steps, kind, approach, fit_skew=False)
    skewed = solve_ladder(steps, kind, approach, fit_skew=True)
    # the test allows for residuals that scatter more than stated even with the skew, as noise
    chi2_gain = max(linear.chi2 - skewed.chi2, 0.0) / skewed.birge**2
    # F (1, dof) is the square of Student's t, for a scatter that was estimated from these steps
    scatter_is_stated = math.isinf(skewed.birge_dof)
    p_value = float(chdtrc(1, chi2_gain) if scatter_is_stated else fdtrc(1, skewed.birge_dof, chi2_gain))
    nonlinear = p_value < _LINEARITY_P_VALUE
    best = skewed if nonlinear else linear
    posterior = scale_posterior(best.trace, kind, best.scale)
    scale, u_scale = posterior.scale, posterior.u_scale
    if not scale > _MIN_SCALE_SIGMA * u_scale:
        raise DataError(
            f"the spot does not follow the {kind}s (scale {scale:.4g} ± {u_scale:.2g} px per unit); "
            "check the order of the steps"
        )
    scale_changes = leave_one_out(steps, kind, approach, nonlinear, best.scale, best.u_scale)
    notes = ladder_notes(posterior)
    for side, birge in (("along", best.birge), ("across", best.birge_across)):
        if birge > 1.0:
            enlarged = side == "across" or posterior.birge > 1.0
            notes.append(
                f"the steps scatter {birge:.2g} times as much as stated {side} the motion; "
                + (
                    "uncertainties were enlarged"
                    if enlarged
                    else "a cubic part or a wrong step explains it, and is in the scale's uncertainty"
                )
            )
    if nonlinear:
        notes.append(f"not linear: skew {with_uncertainty(skewed.skew, skewed.u_skew)} is part of the lever")
    elif kind == "tilt" and skewed.u_skew > _MAX_U_SKEW:
        notes.append(
            "the tilt of the sensor relative to the beam is known only to "
            f"{math.degrees(math.atan(skewed.u_skew)):.0f} degrees (skew "
            f"{with_uncertainty(skewed.skew, skewed.u_skew)}, taken as 0): set the sensor perpendicular to "
            "the beam"
        )
    worst = int(np.nanargmax(np.abs(scale_changes)))
    if abs(scale_changes[worst]) > _MAX_SCALE_CHANGE:
        notes.append(
            f"step {worst + 1} at {_setting(steps.reference[worst], kind, 6)} does not fit the others: "
            f"without it the scale changes by {abs(scale_changes[worst]):.1f} standard uncertainties"
        )
    if abs(best.hysteresis) > _REPORTED_HYSTERESIS_SIGMA * best.u_hysteresis:
        notes.append(
            f"hysteresis of {_setting(best.hysteresis, kind, 3)} ± {_setting(best.u_hysteresis, kind, 2)} "
            "between upward and downward steps"
        )
    u_total = math.hypot(u_scale, u_reference_relative * scale)
    return LadderFit(
        kind=kind,
        scale=scale,
        u_scale=u_total,
        # Welch and Satterthwaite; the reference's uncertainty has infinite degrees of freedom
        scale_dof=posterior.dof * (u_total / u_scale) ** 4,
        origin_px=(float(best.origin_px[0]), float(best.origin_px[1])),
        u_origin_px=(float(best.u_origin_px[0]), float(best.u_origin_px[1])),
        direction_rad=best.direction_rad,
        u_direction_rad=best.u_direction_rad,
        skew=skewed.skew,
        u_skew=skewed.u_skew,
        chance_if_linear=p_value,
        nonlinear=nonlinear,
        cubic=posterior.cubic,
        u_cubic=posterior.u_cubic,
        hysteresis=best.hysteresis,
        u_hysteresis=best.u_hysteresis,
        chi2=best.chi2,
        dof=best.dof,
        leave_one_out=scale_changes,
        residual_px=best.residual_px,
        notes=tuple(notes),
    )


def _setting(setting: float, kind: Literal["tilt", "shift"], digits: int) -> str:
    """A tilt or shift with its unit, as the table of the steps shows it."""
    unit, size = ("arcsec", ARCSEC_RAD) if kind == "tilt" else ("mm", 1e-3)
    return f"{setting / size:.{digits}g} {unit}"


def lever_from_tilts(fit: LadderFit, pixel_pitch_m: float) -> Lever:
    """Lever from a ladder of tilts.

    Tilts determine only the ratio of arm and pixel pitch, so all the uncertainty is assigned to the arm.
    """
    return Lever(
        arm_m=fit.scale * pixel_pitch_m,
        u_arm_m=fit.u_scale * pixel_pitch_m,
        arm_dof=_finite_or_none(fit.scale_dof),
        pixel_pitch_m=pixel_pitch_m,
        skew=fit.skew if fit.nonlinear else 0.0,
        u_skew=min(fit.u_skew, SKEW_PRIOR_STD),
        reference_x_px=fit.origin_px[0],
        reference_y_px=fit.origin_px[1],
    )


def lever_from_shifts(fit: LadderFit, arm_m: float, u_arm_m: float) -> Lever:
    """Lever from known shifts of the sensor, which give the pixel pitch, and an arm measured otherwise."""
    return Lever(
        arm_m=arm_m,
        u_arm_m=u_arm_m,
        pixel_pitch_m=1.0 / fit.scale,
        u_pixel_pitch_m=fit.u_scale / fit.scale**2,
        pixel_pitch_dof=_finite_or_none(fit.scale_dof),
    )


def _finite_or_none(dof: float) -> float | None:
    return dof if math.isfinite(dof) else None


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Comparison of the scale measured now with that of the calibrated lever."""

    ratio: float
    """Scale measured now, over that of the lever."""
    u_ratio: float
    """Standard uncertainty from the present measurement alone."""
    u_both: float
    """Standard uncertainty that includes the lever's."""
    moved: bool
    """Whether the ratio differs from 1 by more than twice `u_both`."""


def check_scale(lever: Lever, fit: LadderFit) -> ScaleCheck:
    """Compare the scale of a ladder of tilts with that of the lever in use."""
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
    u2_independent = [max(u**2 - (ratio * u_common_relative) ** 2, 0.0) for ratio, u in (before, after)]
    change = after[0] - before[0]
    u_change = math.sqrt(sum(u2_independent))
    return change, u_change, abs(change) > _COVERAGE * u_change
