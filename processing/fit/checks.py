"""Checks of turning points before a fit and of the result after it, and the warnings beside its values."""

from collections.abc import Mapping, Sequence

import numpy as np

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.ground import Ground
from processing.fit.result import FitResult, Whiteness
from processing.number_text import plain
from processing.swing import TurningPoints

FEWEST_HALF_CYCLES = 10
"""Twenty amplitudes and times, for the eight columns of the paper's law and the noise."""
_QUIET, _ENOUGH = 0.5, 60
"""Reduced chi-square below which uncertainties are called overstated, of at least so many degrees of freedom:
its chance there is 1e-4."""
OUTLIER = 5.0
"""Residual in standard uncertainties above which a half-cycle is listed as an outlier."""


def check_turning_points(points: TurningPoints) -> None:
    """Raise `DataError` for turning points that cannot be fitted.

    They are too few, out of order or not finite, have uncertainties that are not positive, or the amplitudes
    do not fall.
    """
    count = len(points)
    if count < FEWEST_HALF_CYCLES:
        raise DataError(
            f"{count} usable half-cycles, and a fit needs at least {FEWEST_HALF_CYCLES}: "
            "record for longer or see which were flagged"
        )
    columns = {
        "time_s": points.time_s,
        "u_time_s": points.u_time_s,
        "amplitude": points.amplitude,
        "u_amplitude": points.u_amplitude,
    }
    for name, values in columns.items():
        if len(values) != count:
            raise DataError(f"{name} has {len(values)} values for {count} half-cycles")
        bad = np.nonzero(~np.isfinite(values))[0]
        if len(bad):
            raise DataError(
                f"{name} of half-cycle {points.index[bad[0]]} is {values[bad[0]]}: flag it or leave it out"
            )
    for name in ("u_time_s", "u_amplitude", "amplitude"):
        bad = np.nonzero(columns[name] <= 0)[0]
        if len(bad):
            raise DataError(
                f"{name} of half-cycle {points.index[bad[0]]} is {columns[name][bad[0]]:g}: "
                "it must be positive"
            )
    for name, steps in (("index", np.diff(points.index)), ("time_s", np.diff(points.time_s))):
        bad = np.nonzero(steps <= 0)[0]
        if len(bad):
            raise DataError(
                f"swings out of order: {name} does not rise after half-cycle {points.index[bad[0]]}; "
                "sort them by time"
            )
    third = max(count // 3, 3)
    first = float(np.median(points.amplitude[:third]))
    last = float(np.median(points.amplitude[-third:]))
    if last >= first:
        raise DataError(
            f"the amplitude does not fall (median {first:.4g} of the first third, {last:.4g} of the last): "
            "this is not a free decay"
        )


def jumps(points: TurningPoints, drive_step: float = 0.0) -> list[int]:
    """Half-cycles whose amplitude is significantly larger than the one before: a kick or a vibration.

    `drive_step` is the standard deviation by which the ground moves an amplitude in a half-swing.
    """
    step = np.diff(points.amplitude)
    noise = np.hypot(np.hypot(points.u_amplitude[1:], points.u_amplitude[:-1]), drive_step)
    return [int(i) for i in points.index[1:][(step > 6 * noise) & (step > 0.01 * points.amplitude[:-1])]]


def data_warnings(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    chi2_per_dof: Mapping[str, float],
    drive_step: float = 0.0,
) -> tuple[str, ...]:
    """Warnings about the data that do not depend on the fitted parameters.

    `chi2_per_dof` is that of every part of the fit, by the name of its data.
    """
    warnings = []
    if pendulum is None:
        warnings.append(
            "no calibration: b, c and kappa are in the unit of the amplitudes; neither gamma nor a surface "
            "energy follows from them"
        )
    kicked = jumps(points, drive_step)
    if kicked:
        listed = ", ".join(str(i) for i in kicked[:5]) + (", ..." if len(kicked) > 5 else "")
        warnings.append(f"the amplitude jumps up at half-cycle {listed}: a kick or a vibration")
    part, worst = max(chi2_per_dof.items(), key=lambda item: item[1])
    if worst > 2:
        warnings.append(
            f"χ²/dof of {part} = {plain(worst, 3)}: the data scatter more than their uncertainties say or "
            "the model does not describe them; uncertainties are scaled up by its root"
        )
    return tuple(warnings)


def ground_warnings(ground: Ground, points: TurningPoints) -> tuple[str, ...]:
    """That the end of the run was left out; `points` are those fitted."""
    if not ground.left_out_half_cycles:
        return ()
    text = (
        f"{ground.left_out_half_cycles} half-cycles at the end are left out: below "
        f"{plain(points.amplitude[-1], 3)} rad the ground moves the pendulum in one "
        "half-swing by more than a tenth of its amplitude"
    )
    return (text,)


def correlation_warnings(white: Whiteness) -> tuple[str, ...]:
    """That the residuals are no noise."""
    if not white.correlated:
        return ()
    wider = f"widened by up to {white.widened:.2g}" if white.widened >= 1.05 else "hardly wider"
    chance = plain(min(white.p_amplitude, white.p_time), 1)
    text = (
        f"the residuals of neighbouring half-cycles are correlated (chance {chance}): "
        "the model does not describe all of the motion, or the "
        f"point of rest wanders (pointing of the beam, air); uncertainties are {wider} for it"
    )
    return (text,)


def overstated_u_warnings(chi2_per_dof: float, dof: int) -> tuple[str, ...]:
    """That the turning points scatter less than is stated: it hides a drive, and widens everything."""
    if dof < _ENOUGH or not 0 < chi2_per_dof < _QUIET:
        return ()
    text = (
        f"χ²/dof = {plain(chi2_per_dof, 2)}: the uncertainties of the turning points are "
        f"{chi2_per_dof**-0.5:.2g} times too large for their scatter; so are those of the parameters, and a "
        "weaker drive of the ground is not seen: check sensor noise (rig calibrate sensor) and beam profile"
    )
    return (text,)


def limit_warnings(limited: Sequence[str]) -> tuple[str, ...]:
    """Parameters at a limit of the range of search."""
    return tuple(f"{name} is at the limit of its range: the data do not determine it" for name in limited)


_SMALL_RAD = 0.03
"""Amplitude up to which gravity's moment is taken as proportional: A^2/16 of the period is 6e-5 there."""
_SIGNIFICANT = 3.0
"""Standard uncertainties below zero from which on a sign is a wrong one."""


def domain_warnings(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult
) -> tuple[str, ...]:
    """What is said of a fit outside of the range in which its law has a meaning.

    A ball that rolls by more than the radius of its contact has left the spot on which it stood, and with it
    what Eqs. 1 and 3 are about; beyond pi/2 of it the moment of Eq. 3 has the other sign.
    """
    if pendulum is None:
        return ()
    found = []
    first_rad = float(points.amplitude[0])
    contact_rad = pendulum.contact_radius_m / pendulum.ball_radius_m
    if first_rad > contact_rad:
        found.append(
            f"the first amplitude, {plain(first_rad, 3)} rad, is {plain(first_rad / contact_rad, 3)} times "
            f"the contact's angle a/R = {plain(contact_rad, 3)} rad: the laws of the contact hold only below "
            "it; start lower, or check lever and unit of the angles"
        )
    if first_rad > _SMALL_RAD:
        found.append(
            f"the first amplitude, {plain(first_rad, 3)} rad, is not a small angle: gravity alone lengthens "
            f"the period by {plain(first_rad**2 / 16, 1)} there, which the laws neglect; start below "
            f"{_SMALL_RAD:g} rad"
        )
    for name, below in impossible(fit).items():
        found.append(
            f"{name} = {plain(fit.estimate(name).value, 3)} is negative by {plain(below, 2)} u, which it "
            "cannot be: the law is not that of this motion"
        )
    return tuple(found)


def impossible(fit: FitResult) -> dict[str, float]:
    """By how many standard uncertainties parameters lie below zero that cannot, where it is no chance."""
    found = {}
    for name in fit.contact_names:
        value, u = fit.estimate(name)
        if fit.law.parameter(name).lower == 0 and value < -_SIGNIFICANT * u:
            found[name] = -value / u
    return found
