"""Textbook laws: constant friction, a linear drag alone, Dahl's friction.

- Coulomb: M = -m g R c sign(phi'). Each half-swing takes 2 c and lasts T0/2.
- Viscous: M = -m g R drag_s phi'. The decrement and the period are the same at every amplitude.
- Dahl: the friction approaches its largest value exponentially with the angle since the reversal,
  dM/ds = sigma m g R (1 - M/M_c) with M_c = m g R c.
"""

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import CONSTANT, DRAG, FREE_PERIOD, PERIOD, Parameter
from processing.contact.memory import Arrays, Branch, branch_law
from processing.contact.memoryless import NO_MOMENT, Moment, Moments, memoryless_law


def _coulomb_starts(found: StartValues, _: float) -> list[dict[str, float]]:
    c = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{"c": c, PERIOD: found.mean_period_s}]


def _coulomb(parameters: Floats, _: float, __: float) -> Moments:
    c = float(parameters[0])
    friction = Moment((0,), lambda x: np.full_like(x, c), lambda x: np.array([c * x, x]))
    return Moments(friction, NO_MOMENT)


COULOMB = memoryless_law(
    "constant",
    "constant friction",
    "Coulomb",
    (CONSTANT, FREE_PERIOD),
    _coulomb,
    {"c": Scaling(1.0)},
    lambda _: logarithms_of(),
    _coulomb_starts,
)


def _viscous_starts(found: StartValues, _: float) -> list[dict[str, float]]:
    rate = found.decay.c + max(found.decay.b, 0.0) / (found.decay.p + 1)
    return [{DRAG.key: 4 / np.pi * rate, PERIOD: found.mean_period_s}]


VISCOUS = memoryless_law(
    "viscous",
    "linear drag alone",
    "Stokes",
    (DRAG, FREE_PERIOD),
    lambda parameters, _, __: Moments(NO_MOMENT, NO_MOMENT),
    {},
    lambda _: logarithms_of(),
    _viscous_starts,
)


def _resistance(s: Floats, held: Floats, q: Arrays) -> Floats:
    return np.asarray(q["c"] - (held + q["c"]) * np.exp(-s * q["sigma"] / q["c"]))


def _mean_resistance(s: Floats, held: Floats, q: Arrays) -> Floats:
    way = s * q["sigma"] / q["c"]
    return np.asarray(q["c"] + (held + q["c"]) * np.expm1(-way) / way)


def _at_reversal(amplitude: Floats, q: Arrays) -> Floats:
    return np.asarray(q["c"] * np.tanh(amplitude * q["sigma"] / q["c"]))


def _dahl_starts(found: StartValues, _: float) -> list[dict[str, float]]:
    loss = 2 * (found.decay.c + found.decay.b / (found.decay.p + 1))  # at the reference amplitude
    out = []
    for angle in (0.05, 0.5, 3.0, 20.0):  # c/sigma in units of the reference
        at_one = 2 * (1 - np.tanh(1 / angle) * angle)
        c = max(loss, 1e-9) / max(at_one, 1e-9)
        out.append({"c": c, "sigma": c / angle, PERIOD: found.mean_period_s * np.sqrt(1 + min(c, 1.0))})
    return out


DAHL = branch_law(
    "dahl",
    "Dahl's friction",
    "Dahl 1976",
    (
        Parameter("c", "c", "1", "largest friction, over m g R", "dM/ds = σ (1 - M/c)", lower=0.0,
                  logarithmic=True),
        Parameter("sigma", "σ", "rad⁻¹", "stiffness at a reversal, over m g R", "dM/ds = σ (1 - M/c)",
                  lower=0.0, logarithmic=True),
        FREE_PERIOD,
    ),
    Branch(_resistance, _mean_resistance, _at_reversal),
    {"c": Scaling(1.0), "sigma": Scaling()},
    logarithms_of(0, 1),
    _dahl_starts,
)  # fmt: skip
