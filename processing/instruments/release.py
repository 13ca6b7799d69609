"""The release of a pendulum that was held: the turning point at which its first half-cycle begins.

Before it the deflection is constant. After it, in the time tau since the release, it falls by even powers of
tau, and by tau^3 in proportion to the fraction (0 to 1) of the loss that is by drag. Time and angle of the
release are fitted to the samples on either side.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from processing.arrays import Floats, Ints
from processing.least_squares import FactoredJacobian
from processing.swing import HalfCycle
from processing.units import nanoseconds, seconds

_REACH_HALF_PERIODS = 0.32
"""Half periods fitted on either side: the powers below then follow a cosine to 2e-5 of the amplitude."""
_POWERS = np.array([3, 2, 4, 6])
_U_DRAG_FRACTION = 1 / math.sqrt(12)
"""Prior standard uncertainty of the drag's fraction of the loss, about one half."""
_MIN_REST_SAMPLES = 5
_ITERATIONS = 12
_MAX_CHI2_PER_DOF = 4.0
"""Chi-square per degree of freedom above which the samples are no release from rest."""
_MAX_ANGLE_RATIO = 1.5
"""Largest ratio of the angle of release to the next turning point's: no pendulum loses more."""


def with_release(
    times_ns: Ints, deflection_rad: Floats, u_deflection_rad: Floats, half_cycles: Sequence[HalfCycle]
) -> list[HalfCycle] | None:
    """Half-cycles with the release as the first; None if the samples show no release.

    Parameters
    ----------
    times_ns, deflection_rad, u_deflection_rad
        (n,) samples in which the half-cycles were detected; NaN where the spot was lost.
    half_cycles
        Half-cycles with their rest position. Flagged ones before the first that is not are left out.
    """
    good = [half_cycle for half_cycle in half_cycles if not half_cycle.flags]
    if len(good) < 2 or good[1].index - good[0].index != 1:
        return None
    first, half_s = good[0], float(seconds(good[1].turn_time_ns - good[0].turn_time_ns))
    zero_ns = first.turn_time_ns - nanoseconds(half_s)
    time_s = seconds(times_ns - zero_ns)
    is_near = np.abs(time_s) < 2 * _REACH_HALF_PERIODS * half_s
    use = np.isfinite(deflection_rad) & (u_deflection_rad > 0) & is_near
    side = -first.side
    loss = math.log(first.amplitude / good[1].amplitude)
    if not loss > 0:
        return None
    cubic = loss * first.amplitude * math.pi**2 * _REACH_HALF_PERIODS**3 / 3
    values = side * (deflection_rad[use] - first.centre)
    fit = _release_fit(time_s[use], values, u_deflection_rad[use], half_s, cubic)
    if fit is None:
        return None
    (angle, release_s), (u_angle, u_release_s) = fit
    if not first.amplitude < angle < _MAX_ANGLE_RATIO * first.amplitude:
        return None
    release = replace(
        first,
        index=first.index - 1,
        turn_time_ns=zero_ns + nanoseconds(release_s),
        u_turn_time_s=u_release_s,
        amplitude=angle,
        u_amplitude=u_angle,
        half_period_s=math.nan,
        u_half_period_s=math.nan,
        side=side,
    )
    later = (half_cycle for half_cycle in half_cycles if half_cycle.index > first.index)
    return [release, first.since(release), *later]


def _release_fit(
    time_s: Floats, values: Floats, u_values: Floats, half_s: float, cubic: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Angle and time of the release, and their uncertainties; None if the samples show no release. `cubic` is
    the coefficient of tau^3 for a loss by drag alone."""
    prior_row = np.zeros(len(_POWERS) + 1)
    prior_row[1] = 1 / (_U_DRAG_FRACTION * cubic)
    release_s, scale_s = 0.0, _REACH_HALF_PERIODS * half_s
    for _ in range(_ITERATIONS):
        tau = (time_s - release_s) / scale_s
        use = np.abs(tau) < 1
        rests = use & (tau < 0)
        if np.count_nonzero(rests) < _MIN_REST_SAMPLES or np.count_nonzero(use & ~rests) < 2 * len(_POWERS):
            return None
        since = np.maximum(tau[use], 0.0)[:, None]
        design = np.column_stack([np.ones(len(since)), since**_POWERS]) / u_values[use, None]
        design = np.vstack([design, prior_row])
        measured = np.append(values[use] / u_values[use], 0.5 * cubic * prior_row[1])
        solution = FactoredJacobian(design).coefficients(measured)
        slope = -(_POWERS * since ** (_POWERS - 1)) @ solution[1:] / u_values[use]
        with_time = FactoredJacobian(np.column_stack([design, np.append(slope, 0.0)]))
        residual = measured - design @ solution
        release_s += float(np.clip(with_time.coefficients(residual)[-1], -0.5, 0.5)) * scale_s
        if abs(release_s) > scale_s:
            return None
    chi2_per_dof = float(np.sum(with_time.residual(residual) ** 2)) / (len(measured) - len(with_time.root))
    if chi2_per_dof > _MAX_CHI2_PER_DOF or not solution[0] > 0:
        return None
    u = np.sqrt(np.diag(with_time.covariance()) * max(1.0, chi2_per_dof))
    return (float(solution[0]), release_s), (float(u[0]), float(u[-1]) * scale_s)
