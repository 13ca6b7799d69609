"""Laws judged by the waveform: the third harmonic of the swing against what each of them predicts.

A law that is the same in both directions makes odd harmonics only. Even ones come from the instrument: rows
that are exposed in turn, structure on the sensor, a lever that is not straight; what makes them makes a third
harmonic of like size, so that theirs widens the uncertainty. The fifth is left out: the fast mode swings
there. Uncertainties are from the scatter of few pieces: distances are judged by Student's distribution, and
the chances of the classes put together by Fisher's method.
"""

from collections.abc import Mapping, Sequence
from math import log1p

import numpy as np
from scipy.special import gammaincc

from processing.arrays import Complexes
from processing.contact import PendulumOnBall, law_harmonics
from processing.fit.result import FitResult
from processing.swing import ORDERS, HarmonicClass

CONTRADICTED = 1e-4
"""Chance of so large a distance below which the waveform contradicts a law."""
_OF_PREDICTION = 0.001
"""What `law_harmonics` leaves out, of the harmonic."""
_THIRD, _EVEN = ORDERS.index(3), [ORDERS.index(2), ORDERS.index(4)]


def predicted_harmonics(
    classes: Sequence[HarmonicClass], fit: FitResult, pendulum: PendulumOnBall
) -> list[Complexes]:
    """A fitted law's harmonics (rad) in each class."""
    values = dict(zip(fit.names, fit.values.tolist(), strict=True))
    return [one.mean(lambda a: law_harmonics(fit.law, values, pendulum, a)) for one in classes]


def waveform_chances(
    classes: Sequence[HarmonicClass], predicted: Mapping[str, Sequence[Complexes]]
) -> dict[str, float]:
    """For each law the chance of a third harmonic at least so far from its prediction."""
    chances = {}
    for name, laws in predicted.items():
        chi2 = 0.0
        for one, harmonics in zip(classes, laws, strict=True):
            of_instrument = np.mean(np.abs(one.harmonics[_EVEN]) ** 2) / 2
            variance = one.u[_THIRD] ** 2 + of_instrument + (_OF_PREDICTION * abs(harmonics[_THIRD])) ** 2
            distance = float(abs(one.harmonics[_THIRD] - harmonics[_THIRD]) ** 2 / variance)
            freedom = 2 * (len(one.amplitudes) - 2)
            chi2 += freedom * log1p(distance / freedom)
        chances[name] = float(gammaincc(len(classes), 0.5 * chi2)) if classes else np.nan
    return chances
