"""How far the third harmonic of the swing is from that of a fitted law.

A law that is the same in both directions makes odd harmonics only. Even ones come from the instrument: rows
that are exposed in turn, structure on the sensor, a lever that is not straight. These make a third harmonic
of like size, so that the even ones enlarge its uncertainty. The fifth is left out: there is the fast mode.
Uncertainties are from the scatter of few pieces: distances are judged by Student's distribution, and the
chances of the classes are combined by Fisher's method.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from processing.arrays import Complexes, Floats
from processing.contact import PendulumOnBall, law_harmonics
from processing.errors import DataError
from processing.fit.result import FitResult
from processing.fit.terms import LinearisedFit
from processing.least_squares import FactoredJacobian, differenced, solve
from processing.swing import ORDERS, HarmonicClass, TurningPoints

CONTRADICTED = 1e-4
"""Chance of so large a distance below which the waveform contradicts a law."""
_U_PREDICTION = 0.001
"""Relative error of a harmonic by `law_harmonics`."""
_THIRD, _EVEN = ORDERS.index(3), [ORDERS.index(2), ORDERS.index(4)]


def _harmonics(classes: Sequence[HarmonicClass], fit: FitResult, pendulum: PendulumOnBall) -> list[Complexes]:
    """A fitted law's harmonics (rad) in each class."""
    return [one.mean(lambda a: law_harmonics(fit.law, fit.named_values, pendulum, a)) for one in classes]


Predicted = Callable[[Floats], Sequence[Complexes]]
"""A law's harmonics (rad) in each class, by errors of its fit in standard uncertainties."""


def predictions(
    classes: Sequence[HarmonicClass], points: TurningPoints, fit: FitResult, pendulum: PendulumOnBall
) -> tuple[int, Predicted]:
    """The number of independent errors of a fit, and its law's harmonics by them."""
    try:
        at = LinearisedFit.of(points, pendulum, fit)
    except DataError:
        # at the values of a law that does not fit, its waveform may have no derivatives
        return 0, lambda _: _harmonics(classes, fit, pendulum)
    root = FactoredJacobian(at.jacobian).root

    def by(errors: Floats) -> Sequence[Complexes]:
        values = at.model.columns.physical(at.coordinates + root @ errors)[0]
        return _harmonics(classes, replace(fit, values=values), pendulum)

    return root.shape[1], by


def waveform_chances(
    classes: Sequence[HarmonicClass], laws: Mapping[str, tuple[int, Predicted]]
) -> dict[str, float]:
    """For each law the chance of a third harmonic at least so far from its prediction.

    A law whose friction would hold the pendulum in a class, which may be one that does not fit, has none.
    The prediction is the one within the fit's errors that comes nearest, at the cost of their chi2.
    """
    from scipy.special import gammaincc

    chances = {}
    of_instrument = np.array([np.mean(np.abs(one.harmonics[_EVEN]) ** 2) / 2 for one in classes])
    u2 = np.array([one.u[_THIRD] for one in classes]) ** 2 + of_instrument
    freedom = np.array([2 * (len(one.amplitudes) - 2) for one in classes])
    seen = np.array([one.harmonics[_THIRD] for one in classes])

    def residuals(errors: Floats, predicted: Predicted) -> Floats:
        try:
            third = np.array([harmonics[_THIRD] for harmonics in predicted(errors)])
        except DataError:
            # the search goes nearer to the fit
            return np.full(2 * len(seen) + len(errors), np.nan)
        off = (seen - third) / np.sqrt(u2 + (_U_PREDICTION * np.abs(third)) ** 2)
        x = np.abs(off) ** 2 / freedom
        off *= np.sqrt(np.divide(np.log1p(x), x, out=np.ones_like(x), where=x > 0))
        return np.concatenate([off.real, off.imag, errors])

    for name, (count, predicted) in laws.items() if classes else ():
        none = np.zeros(count)
        chi2 = float(np.sum(residuals(none, predicted) ** 2))
        if not np.isfinite(chi2):
            continue
        if count:
            found = solve(differenced(partial(residuals, predicted=predicted)), none, max_evaluations=20)
            chi2 = min(chi2, found.chi2)
        chances[name] = float(gammaincc(len(classes), 0.5 * chi2))
    return chances
