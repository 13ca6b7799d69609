"""Coulomb friction alone: M = -m g R c sign(phi'). Each half-swing takes 2 c and lasts T0/2."""

from processing.contact.branch import without_memory
from processing.contact.branch_columns import PERIOD, Scaling, logarithms_of
from processing.contact.branch_law import CONSTANT, FREE_PERIOD, branch_law
from processing.contact.start_values import StartValues


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    c = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{"c": c, PERIOD: found.mean_period_s}]


COULOMB = branch_law(
    "constant",
    "constant friction",
    "Coulomb",
    (CONSTANT, FREE_PERIOD),
    without_memory(CONSTANT.key),
    {"c": Scaling(1.0)},
    logarithms_of(),
    _likely,
)
