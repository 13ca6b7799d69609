"""Coulomb friction alone: M = -m g R c sign(phi'). Each half-swing takes 2 c and lasts T0/2."""

import numpy as np

from processing.contact.branch import Array, Arrays, Branch
from processing.contact.branch_columns import PERIOD, Scaling, logarithms_of
from processing.contact.branch_law import CONSTANT, FREE_PERIOD, branch_law
from processing.contact.start_values import StartValues


def _resistance(s: Array, held: Array, q: Arrays) -> Array:
    return np.zeros(np.broadcast(s, held).shape)


def _at_reversal(amplitude: Array, q: Arrays) -> Array:
    return np.ones_like(amplitude)


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    c = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{"c": c, PERIOD: found.mean_period_s}]


COULOMB = branch_law(
    "constant",
    "constant friction",
    "Coulomb",
    (CONSTANT, FREE_PERIOD),
    Branch(_resistance, _resistance, _at_reversal, CONSTANT.key),
    {"c": Scaling(1.0)},
    logarithms_of(),
    _likely,
)
