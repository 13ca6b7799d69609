"""Friction of a pendulum of any amplitude, from its turning points: moment = q (phi/phi_ref)^s.

The moment is divided by m g d, with the lever arm d of the centre of mass. Between two turning points A and B

    cos B - cos A = D(A) + D(B)        D(x) = q phi_ref (x/phi_ref)^(s+1) / (s+1)

by conservation of energy. At the turning points the kinetic energy is zero, so that neither inertia nor
rolling of the support enters. s = 0 is friction independent of amplitude and speed, s = 1 gives a constant
decrement.

Rolling friction after Tomlinson tests whether the decrement is constant and the coefficient depends on speed.
The energy loss of a cycle divided by the angle covered is the mean moment. Divided by load and radius, it is
the coefficient of rolling friction.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.decay_summary import reference_amplitude
from processing.errors import DataError
from processing.estimate import Estimate
from processing.kernel import kernel
from processing.least_squares import differenced, solve
from processing.swing import TurningPoints

_MIN_POINTS = 6


@dataclass(frozen=True, slots=True)
class FrictionLaw:
    """The fitted law. Uncertainties are multiplied by sqrt(max(1, chi2/dof))."""

    reference_rad: float
    moment: Estimate
    """q at `reference_rad`, over m g d."""
    exponent: Estimate
    covariance: Floats
    """Covariance of (ln initial amplitude, ln q, s)."""
    chi2_per_dof: float

    @property
    def mean_moment(self) -> Estimate:
        """Mean moment over a half-cycle of the reference amplitude, q/(s+1), over m g d."""
        value = self.moment.value / (1 + self.exponent.value)
        log_derivatives = np.array([0.0, 1.0, -1 / (1 + self.exponent.value)])
        return Estimate(value, value * math.sqrt(log_derivatives @ self.covariance @ log_derivatives))

    def decrement(self, amplitude_rad: float) -> Estimate:
        """Logarithmic decrement of a full swing, ln(A_i/A_(i+2)), for this geometric mean of both amplitudes.

        Raises DataError if friction would stop the pendulum within the swing.
        """
        log_moment, exponent = math.log(self.moment.value), self.exponent.value
        value = 0.0
        for _ in range(20):
            begin = math.log(amplitude_rad) + 0.5 * value
            ends = _decay(begin, log_moment, exponent, self.reference_rad, np.array([0, 2]))
            if not ends[1] > 0:
                raise DataError("friction holds the pendulum within one swing; it has no decrement")
            last_value, value = value, math.log(ends[0] / ends[1])
            if abs(value - last_value) <= 1e-14 * value:
                break
        log_ratio = math.log(amplitude_rad / self.reference_rad)
        # to first order the decrement is proportional to the mean moment
        log_derivatives = np.array([0.0, 1.0, log_ratio - 1 / (1 + exponent)])
        return Estimate(value, value * math.sqrt(log_derivatives @ self.covariance @ log_derivatives))


def fit_friction_law(points: TurningPoints) -> FrictionLaw:
    """Least-squares fit to the amplitudes of all turning points.

    Raises DataError for fewer than six turning points, for amplitudes that do not fall, or if the data do not
    determine the law.
    """
    if len(points) < _MIN_POINTS:
        raise DataError(
            f"{len(points)} usable turning points, at least {_MIN_POINTS} are needed for a law of friction"
        )
    amplitude, steps = points.amplitude, points.index - points.index[0]
    fall = float(np.log(amplitude[0] / amplitude[-1]))
    if not fall > 0:
        raise DataError("the amplitude does not fall; no friction can be had from it")
    reference = reference_amplitude(points)
    start = np.array([math.log(amplitude[0]), math.log(fall / float(steps[-1]) * reference), 1.0])

    def residuals(x: Floats) -> Floats:
        return (_decay(x[0], x[1], x[2], reference, steps) - amplitude) / points.u_amplitude

    lower, upper = np.array([-np.inf, -np.inf, -0.9]), np.array([math.log(math.pi), 0.0, 6.0])
    solution = solve(differenced(residuals), start, lower=lower, upper=upper)
    chi2_per_dof = solution.chi2 / solution.dof
    covariance = solution.covariance * max(1.0, chi2_per_dof)
    if not np.all(np.isfinite(np.diag(covariance))):
        raise DataError("the decay is too short to tell friction from its exponent; measure longer")
    _, u_log_moment, u_exponent = np.sqrt(np.diag(covariance)).tolist()
    _, log_moment, exponent = solution.values.tolist()
    moment = math.exp(log_moment)
    return FrictionLaw(
        reference_rad=reference,
        moment=Estimate(moment, moment * u_log_moment),
        exponent=Estimate(exponent, u_exponent),
        covariance=covariance,
        chi2_per_dof=chi2_per_dof,
    )


class RollingFriction(NamedTuple):
    """Rolling friction of a decay, at `law.reference_rad`, the geometric mean of the amplitudes."""

    law: FrictionLaw
    decrement: Estimate
    """Proportional to amplitude^(exponent - 1)."""
    coefficient: Estimate | None
    """Proportional to amplitude^exponent, and likewise to the same power of the largest speed."""
    sentences: tuple[str, str]
    """Whether these exponents differ from zero by more than two standard uncertainties."""


def rolling_friction(
    points: TurningPoints, lever_m: Estimate | None, radius_m: Estimate | None
) -> RollingFriction:
    """Decrement and coefficient from turning points.

    Parameters
    ----------
    lever_m
        Distance of the centre of mass below the axis of rolling; with it, moments are known relative to m g.
    radius_m
        Radius of the axis or ball that rolls. If either is None, no coefficient is computed.

    Raises
    ------
    DataError
        Too few turning points or no decay.
    """
    law = fit_friction_law(points)
    coefficient = None
    if lever_m is not None and radius_m is not None:
        if not (lever_m.value > 0 and radius_m.value > 0):
            raise DataError("lever and radius of the support must be positive")
        mean = law.mean_moment
        value = mean.value * lever_m.value / radius_m.value
        relative = math.hypot(
            mean.standard_uncertainty / mean.value,
            lever_m.standard_uncertainty / lever_m.value,
            radius_m.standard_uncertainty / radius_m.value,
        )
        coefficient = Estimate(value, value * relative)
    s, u = law.exponent
    constant, independent = abs(s - 1) <= 2 * u, abs(s) <= 2 * u
    digits = max(2, 1 - math.floor(math.log10(u))) if 0 < u < 1 else 2
    decrement = (
        f"the log decrement is {'constant' if constant else 'not constant'}: "
        f"it goes as amplitude^({s - 1:+.{digits}f} ± {u:.{digits}f})"
    )
    speed = (
        f"the rolling-friction coefficient is {'independent' if independent else 'not independent'} "
        f"of speed: it goes as amplitude^({s:.{digits}f} ± {u:.{digits}f})"
    )
    return RollingFriction(law, law.decrement(law.reference_rad), coefficient, (decrement, speed))


@kernel
def _decay(log_initial: float, log_moment: float, exponent: float, reference: float, steps: Ints) -> Floats:
    """Amplitudes at the half-cycles `steps`, which rise from 0; 0 after friction has stopped the pendulum."""
    found = np.zeros(len(steps))
    amplitude = math.exp(log_initial)
    scale = math.exp(log_moment) * reference / (1 + exponent)
    found[0] = amplitude
    reached = 0
    for k in range(1, len(steps)):
        while reached < steps[k]:
            # 1 - cos by the half-angle formula, which loses no digits at small angles
            left = 2 * math.sin(0.5 * amplitude) ** 2 - scale * (amplitude / reference) ** (exponent + 1)
            if left <= 0:
                return found
            new = amplitude
            for _ in range(30):
                power = scale * (new / reference) ** (exponent + 1)
                change = (2 * math.sin(0.5 * new) ** 2 + power - left) / (
                    math.sin(new) + power * (exponent + 1) / new
                )
                new = max(new - change, 0.1 * new)
                if abs(change) <= 1e-15 * new:
                    break
            amplitude = new
            reached += 1
        found[k] = amplitude
    return found


class HerbertHardness(NamedTuple):
    """Herbert's hardness numbers; a single swing is a half-cycle."""

    ten_swings_s: Estimate | None
    """Time of ten single swings; None if the record has fewer than ten in a row."""
    first_swing_times_ten_s: Estimate
    """Ten times the time of the first one."""
    scale_hardness: Estimate
    """Reading of the scale after the first one."""
    first_amplitude_rad: float
    missing: str
    """Reason why `ten_swings_s` is None; else empty."""


def herbert_hardness(points: TurningPoints, divisions: float = 100.0) -> HerbertHardness:
    """Hardness numbers from the first swings that were recorded completely.

    Parameters
    ----------
    divisions
        Number of scale divisions between the angle of release and the same angle on the other side, the
        reading after a swing without loss. The scale's zero is the turning point at which the first swing
        starts.

    Raises
    ------
    DataError
        No two successive turning points at the beginning.
    """
    if len(points) < 2 or points.index[1] - points.index[0] != 1:
        raise DataError("the first swing was not seen whole: two successive turning points are needed")
    first_swing = _time_since_first(points, 1)
    ratio = float(points.amplitude[1] / points.amplitude[0])
    u_ratio = ratio * float(np.hypot(*(points.u_amplitude[:2] / points.amplitude[:2])))
    tenth = np.flatnonzero(points.index == points.index[0] + 10)
    ten_swings, missing = None, ""
    if len(tenth):
        ten_swings = _time_since_first(points, int(tenth[0]))
    else:
        count = int(points.index[-1] - points.index[0])
        missing = f"no time of ten single swings: the record holds {count}, or the tenth is disturbed"
    return HerbertHardness(
        ten_swings,
        Estimate(10 * first_swing.value, 10 * first_swing.standard_uncertainty),
        Estimate(0.5 * divisions * (1 + ratio), 0.5 * divisions * u_ratio),
        float(points.amplitude[0]),
        missing,
    )


def _time_since_first(points: TurningPoints, last: int) -> Estimate:
    duration_s = float(points.time_s[last] - points.time_s[0])
    return Estimate(duration_s, math.hypot(points.u_time_s[0], points.u_time_s[last]))
