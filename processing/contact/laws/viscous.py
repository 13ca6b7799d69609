"""Linear drag alone: M = -m g R drag_s phi'. The decrement and the period are the same at every amplitude."""

import numpy as np

from processing.contact.branch import Array, Arrays, Branch
from processing.contact.branch_columns import PERIOD, logarithms_of
from processing.contact.branch_law import FREE_PERIOD, branch_law
from processing.contact.law import DRAG
from processing.contact.start_values import StartValues


def _resistance(s: Array, held: Array, q: Arrays) -> Array:
    return np.zeros(np.broadcast(s, held).shape)


def _at_reversal(amplitude: Array, q: Arrays) -> Array:
    return np.ones_like(amplitude)


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    rate = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{DRAG.key: 4 / np.pi * rate, PERIOD: found.mean_period_s}]


VISCOUS = branch_law(
    "viscous",
    "linear drag alone",
    "Stokes",
    (DRAG, FREE_PERIOD),
    Branch(_resistance, _resistance, _at_reversal),
    {},
    logarithms_of(),
    _likely,
)
