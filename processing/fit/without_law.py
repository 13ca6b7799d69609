"""The contact's moments from one decay without any law, and what fitted laws say in the same terms."""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from processing.arrays import Floats
from processing.contact import MomentSplines, PendulumOnBall, spline_law, weight_moment
from processing.fit.exact import fit_exact
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.least_squares import solve
from processing.swing import TurningPoints

_INWARDS = 1.1
"""How far the angles shown stay from both ends of the amplitudes."""


@dataclass(frozen=True, slots=True)
class FreeMoments:
    """Friction against the motion, and elastic moment in the direction of phi, at angles `phi_rad` > 0.

    The elastic moment is what departs from proportionality: it vanishes at `reference_rad`, where the period
    is that of gravity alone by definition. `u_` are standard uncertainties; bands of one of them cover 68 %.
    """

    phi_rad: Floats
    friction_n_m: Floats
    u_friction_n_m: Floats
    elastic_n_m: Floats
    u_elastic_n_m: Floats
    reference_rad: float


@dataclass(frozen=True, slots=True)
class WithoutLaw:
    """The fit of splines to one decay, and what it says."""

    points: TurningPoints
    pendulum: PendulumOnBall
    splines: MomentSplines
    fit: FitResult

    def moments(self, phi_rad: Floats | None = None) -> FreeMoments:
        """Moments with bands; by default at 41 angles between the lowest and the highest amplitude."""
        if phi_rad is None:
            low, high = self.points.amplitude.min() * _INWARDS, self.points.amplitude.max() / _INWARDS
            phi_rad = np.geomspace(low, high, 41)
        return self._of(phi_rad, self.fit.values, self.fit.covariance)

    def _of(self, phi_rad: Floats, values: Floats, covariance: Floats) -> FreeMoments:
        unit_rad, weight = self.splines.unit_rad, weight_moment(self.pendulum)
        x = phi_rad / unit_rad
        friction, elastic = weight * self.splines.friction(x), weight * unit_rad * self.splines.elastic(x)
        of_friction = slice(0, self.splines.friction_count)
        of_elastic = slice(of_friction.stop, of_friction.stop + self.splines.elastic_count)
        return FreeMoments(
            phi_rad,
            friction @ values[of_friction],
            _uncertainty(friction, covariance[of_friction, of_friction]),
            elastic @ values[of_elastic],
            _uncertainty(elastic, covariance[of_elastic, of_elastic]),
            unit_rad,
        )

    def of_law(self, fit: FitResult, phi_rad: Floats) -> FreeMoments:
        """What a fitted law says in the same terms: the splines that have its turning points.

        The uncertainties are 0.
        """
        law, columns = ExactModel.of(self.points, self.pendulum, fit)
        amplitude, time_s, _, _ = law.curve(columns)
        swung = replace(law.points, amplitude=amplitude * law.reference, time_s=time_s)
        reached = int(np.count_nonzero(np.isfinite(time_s)))
        model = ExactModel(swung.first(reached), self.pendulum, law=self.fit.law)
        start = next(chain(model.start_near(self.fit), model.starts()))
        solution = solve(model, start, lower=model.lower, upper=model.upper)
        values, _ = model.columns.physical(solution.values)
        return self._of(phi_rad, values, np.zeros_like(self.fit.covariance))


def _uncertainty(basis: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", basis, covariance, basis)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_without_law(points: TurningPoints, pendulum: PendulumOnBall) -> WithoutLaw:
    """Friction and elastic moment of one decay as splines, with the drive of the ground that they leave.

    Raises
    ------
    DataError
        As `fit_exact`.
    """
    law, splines = spline_law(points)
    fit = fit_exact(points, pendulum, law=law)
    return WithoutLaw(points.first(fit.half_cycles), pendulum, splines, fit)
