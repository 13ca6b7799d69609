"""The contact's moments from one decay without any law, and what fitted laws say in the same terms."""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, MomentSplines, PendulumOnBall, spline_law, weight_moment
from processing.estimate import Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact, start_near, starts_of
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.least_squares import solve
from processing.swing import TurningPoints

_HELD = 1e-4
"""Relative uncertainty of a drag that is held."""
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
        drag = self.fit.has_drag
        # the drag is the law's, so that the splines hold its friction alone
        known_s = fit.estimate(DRAG.key).value if fit.has_drag else 0.0
        known_s *= _stiffer(fit, self.fit.estimate("period0_s").value)
        held = Evidence(drag_s=_exactly(known_s)) if drag else NO_EVIDENCE
        model = ExactModel(swung.first(reached), self.pendulum, law=self.fit.law, drag=drag, evidence=held)
        start = next(chain(start_near(model, self.fit), starts_of(model)))
        model = model.about(start)
        solution = solve(model, start, lower=model.lower, upper=model.upper)
        values, _ = model.columns.physical(solution.values)
        return self._of(phi_rad, values, np.zeros_like(self.fit.covariance))


def _stiffer(fit: FitResult, period_s: float) -> float:
    """A drag in the splines' terms over that in a law's.

    It is over the stiffness, which the splines take to be gravity's alone where the period is `period_s`.
    """
    return (period_s / fit.estimate("period0_s").value) ** 2


def _exactly(drag_s: float) -> Estimate:
    return Estimate(drag_s, _HELD * max(abs(drag_s), 1e-6))


def _uncertainty(basis: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", basis, covariance, basis)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_without_law(
    points: TurningPoints, pendulum: PendulumOnBall, *, like: FitResult | None = None
) -> WithoutLaw:
    """Friction and elastic moment of one decay as splines, with the drive of the ground that they leave.

    Where an exact fit `like` this one has a drag, so has this, and its evidence: without any of it splines
    would take the drag for friction, and none is fitted then.

    Raises
    ------
    DataError
        As `fit_exact`.
    """
    law, splines = spline_law(points)
    evidence = NO_EVIDENCE if like is None else like.evidence
    if like is not None and evidence.drag_s is not None:
        factor = _stiffer(like, like.mean_period_s.value)
        evidence = replace(evidence, drag_s=Estimate(*(factor * number for number in evidence.drag_s)))
    drag = like is not None and like.has_drag and evidence != NO_EVIDENCE
    fit = fit_exact(points, pendulum, law=law, drag=drag, evidence=evidence)
    return WithoutLaw(points.first(fit.half_cycles), pendulum, splines, fit)
