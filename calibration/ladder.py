"""A ladder: steps of known tilts, or of known shifts, with the places of the spot."""

import math
from dataclasses import dataclass

import numpy as np

from calibration.birge import birge_ratio
from processing.arrays import Floats
from processing.errors import DataError
from processing.least_squares import solve
from processing.units import ARCSEC_RAD

FEWEST_STEPS = 5
"""Along the motion at most origin, scale, skew and hysteresis are fitted: one degree of freedom remains."""


@dataclass(frozen=True, slots=True)
class LadderSteps:
    """Steps of a ladder in the order of the measurement, arrays (n,).

    `reference` is the known tilt in rad or the known shift in m, `u_reference` its standard uncertainty in
    one setting (`u_reference_relative` of `fit_ladder` is that of a factor common to all settings). `x_px`
    and `y_px` are the mean positions of the spot, `u_x_px` and `u_y_px` their standard uncertainties.
    """

    reference: Floats
    u_reference: Floats
    x_px: Floats
    y_px: Floats
    u_x_px: Floats
    u_y_px: Floats


def check_steps(steps: LadderSteps, kind: str) -> None:
    """Raise DataError for a ladder that cannot be fitted."""
    count = len(steps.reference)
    if count < FEWEST_STEPS:
        raise DataError(f"lever: the ladder has {count} steps; at least {FEWEST_STEPS} are needed")
    for name in ("reference", "u_reference", "x_px", "y_px", "u_x_px", "u_y_px"):
        values = getattr(steps, name)
        if not np.all(np.isfinite(values)):
            step = int(np.argmin(np.isfinite(values))) + 1
            raise DataError(f"lever: step {step} of the ladder has no {name}; measure it again")
    if not (np.all(steps.u_x_px > 0) and np.all(steps.u_y_px > 0) and np.all(steps.u_reference >= 0)):
        raise DataError(
            "lever: a standard uncertainty is not positive; state u_px and u_reference of each step"
        )
    if len(np.unique(steps.reference)) < 3:
        raise DataError(
            f"lever: the ladder has {len(np.unique(steps.reference))} different settings; "
            "at least 3 are needed"
        )
    if kind == "tilt" and not (np.any(steps.reference > 0) and np.any(steps.reference < 0)):
        raise DataError(
            f"lever: the tilts are all of one sign ({steps.reference.min() / ARCSEC_RAD:.4g} to "
            f"{steps.reference.max() / ARCSEC_RAD:.4g} arcsec); measure on both sides of zero"
        )


def ways_of(reference: Floats) -> Floats:
    """+1 for a setting approached from below, -1 from above; a repeated setting counts as the one before."""
    way = np.sign(np.diff(reference))
    for i in range(1, len(way)):
        way[i] = way[i] or way[i - 1]
    first = way[np.flatnonzero(way)[0]] if np.any(way) else 1.0
    way[way == 0] = first
    return np.concatenate([[first], way])


def both_ways(way: Floats) -> Floats | None:
    """The ways, if there are both, so that a hysteresis can be told."""
    return way if np.any(way > 0) and np.any(way < 0) else None


@dataclass(frozen=True, slots=True)
class LadderSolution:
    """Solution of the least-squares problem.

    `values` are origin (x, y), scale (x, y), then skew and hysteresis if they are fitted, `fixed` in number,
    followed by the deviation of each step's true setting from the stated one in units of `u_reference`.
    `covariance` (fixed, fixed) is that of the first ones, enlarged along the motion by `birge`, across it by
    `birge_across`. `along_dof` are the degrees of freedom of `birge`, infinite where it is 1.
    """

    values: Floats
    covariance: Floats
    fixed: int
    chi2: float
    dof: int
    birge: float
    birge_across: float
    along_dof: float
    residual_px: Floats

    def u(self, index: int) -> float:
        return float(np.sqrt(self.covariance[index, index]))

    def scale(self) -> tuple[float, float]:
        k = self.values[2:4]
        scale = float(np.hypot(*k))
        return scale, float(np.sqrt(k @ self.covariance[2:4, 2:4] @ k)) / max(scale, 1e-300)


def solve_ladder(steps: LadderSteps, kind: str, way: Floats | None, *, bent: bool) -> LadderSolution:
    """Least squares, with the skew as a parameter if `bent` and the hysteresis if `way` is given."""
    count = len(steps.reference)
    fixed = 4 + bent + (way is not None)

    def carrier(setting: Floats) -> Floats:
        return np.tan(2.0 * setting) if kind == "tilt" else setting

    def slope(setting: Floats) -> Floats:
        return 2.0 / np.cos(2.0 * setting) ** 2 if kind == "tilt" else np.ones_like(setting)

    span = float(np.ptp(carrier(steps.reference)))
    start = np.polyfit(carrier(steps.reference), np.column_stack([steps.x_px, steps.y_px]), 1)
    unit = np.ones(fixed)
    unit[2:4] = 1.0 / span
    if bent:
        unit[4] = 1.0 / span
    if way is not None:
        unit[fixed - 1] = float(np.ptp(steps.reference))

    def parts(p: Floats) -> tuple[Floats, Floats, Floats]:
        setting = steps.reference + steps.u_reference * p[fixed:]
        if way is not None:
            setting = setting + 0.5 * way * p[fixed - 1] * unit[fixed - 1]
        t = carrier(setting)
        skew = p[4] * unit[4] if bent else 0.0
        return setting, t, t * (1.0 + skew * t)

    def residual(p: Floats) -> Floats:
        _, _, along = parts(p)
        kx, ky = p[2] * unit[2], p[3] * unit[3]
        return np.concatenate(
            [
                (p[0] + kx * along - steps.x_px) / steps.u_x_px,
                (p[1] + ky * along - steps.y_px) / steps.u_y_px,
                p[fixed:],
            ]
        )

    def jacobian(p: Floats) -> Floats:
        setting, t, along = parts(p)
        skew = p[4] * unit[4] if bent else 0.0
        by_setting = slope(setting) * (1.0 + 2.0 * skew * t)
        out = np.zeros((3 * count, fixed + count))
        for row, k, u, at in (
            (0, p[2] * unit[2], steps.u_x_px, 0),
            (count, p[3] * unit[3], steps.u_y_px, 1),
        ):
            rows = np.arange(row, row + count)
            out[rows, at] = 1.0 / u
            out[rows, 2 + at] = along * unit[2 + at] / u
            if bent:
                out[rows, 4] = k * t**2 * unit[4] / u
            if way is not None:
                out[rows, fixed - 1] = k * by_setting * 0.5 * way * unit[fixed - 1] / u
            out[rows, fixed + np.arange(count)] = k * by_setting * steps.u_reference / u
        out[2 * count + np.arange(count), fixed + np.arange(count)] = 1.0
        return out

    p0 = np.zeros(fixed + count)
    p0[0:2], p0[2:4] = start[1], start[0] / unit[2:4]
    found = solve(lambda p: (residual(p), jacobian(p)), p0)
    full = found.covariance[:fixed, :fixed] * np.outer(unit, unit)
    values = found.values.copy()
    values[:fixed] *= unit
    _, _, along = parts(found.values)
    residual_px = np.column_stack(
        [steps.x_px - values[0] - values[2] * along, steps.y_px - values[1] - values[3] * along]
    )
    # rows: unit vectors along and across the motion
    turn = np.array([values[2:4], [-values[3], values[2]]]) / np.hypot(values[2], values[3])
    u_px = np.sqrt(turn**2 @ np.array([steps.u_x_px, steps.u_y_px]) ** 2)
    chi2_along, chi2_across = (((turn @ residual_px.T) / u_px) ** 2).sum(axis=1)
    chi2_along += float(found.values[fixed:] @ found.values[fixed:])
    dof_along, dof_across = count - fixed + 2, count - 2
    birge, birge_across = birge_ratio(chi2_along, dof_along), birge_ratio(chi2_across, dof_across)
    enlarged = np.eye(fixed) * birge
    for at in (0, 2):
        enlarged[at : at + 2, at : at + 2] = turn.T @ np.diag([birge, birge_across]) @ turn
    return LadderSolution(
        values,
        enlarged @ full @ enlarged,
        fixed,
        found.chi2,
        2 * count - fixed,
        birge,
        birge_across,
        dof_along if birge > 1.0 else math.inf,
        residual_px,
    )


def leave_one_out(
    steps: LadderSteps, kind: str, way: Floats | None, bent: bool, scale: float, u_scale: float
) -> Floats:
    """Change of the scale without each step in units of that change's own standard uncertainty."""
    change = np.full(len(steps.reference), np.nan)
    for i in range(len(change)):
        rest = LadderSteps(*(np.delete(getattr(steps, name), i) for name in LadderSteps.__slots__))
        left_way = None if way is None else both_ways(np.delete(way, i))
        if len(np.unique(rest.reference)) < 3:
            continue
        without, u_without = solve_ladder(rest, kind, left_way, bent=bent).scale()
        spread = math.sqrt(max(u_without**2 - u_scale**2, (0.05 * u_scale) ** 2))
        change[i] = (without - scale) / spread
    return change
