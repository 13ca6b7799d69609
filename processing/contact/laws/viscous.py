"""Linear drag alone: M = -m g R drag_s phi'. The decrement and the period are the same at every amplitude."""

import numpy as np

from processing.contact.branch import without_memory
from processing.contact.branch_columns import PERIOD, logarithms_of
from processing.contact.branch_law import FREE_PERIOD, branch_law
from processing.contact.law import DRAG
from processing.contact.start_values import StartValues


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    rate = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{DRAG.key: 4 / np.pi * rate, PERIOD: found.mean_period_s}]


VISCOUS = branch_law(
    "viscous",
    "linear drag alone",
    "Stokes",
    (DRAG, FREE_PERIOD),
    without_memory(),
    {},
    logarithms_of(),
    _likely,
)
