"""Rolling with memory: a backbone that is a power of the angle, doubled on every branch (Masing's rule).

    f(phi) = k phi^q,    M = M_reversal - 2 k m g R (s/2)^q - m g R c sign(phi')

with s the angle since the reversal. Al-Bender & De Moerlooze (2008) find it for rolling before gross slip.
Per cycle it takes ``4 k (1-q)/(1+q) A^(q+1)``, as b of Eq. 1 does with p = q and b = k (1-q), and it makes
the period depend on the amplitude without any further parameter.
"""

import numpy as np
from scipy.special import loggamma

from processing.arrays import Floats
from processing.contact.coordinates import ComplexOrReal, Scaling, Straight
from processing.contact.law import CONSTANT, FREE_PERIOD, PERIOD, HeldColumn, Parameter
from processing.contact.memory import Arrays, branch_law, masing
from processing.contact.start_values import StartValues


def _backbone(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** q["q"])


def _work(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** (q["q"] + 1) / (q["q"] + 1))


def _stiffness(q: ComplexOrReal) -> ComplexOrReal:
    """Moment in phase with a swing of amplitude 1, for k = 1."""
    return np.asarray(4 / np.sqrt(np.pi) * np.exp(loggamma(q + 0.5) - loggamma(q + 1)) * q / (q + 1))


def _scaled(values: ComplexOrReal) -> ComplexOrReal:
    """k, q, c, T0 from ln of the loss and the share of the contact in the stiffness, c and period of a swing.

    Gravity has the rest of the stiffness. Decay and period determine these; if the contact were much stiffer
    than gravity, k could be anything.
    """
    log_loss, share, c, drag, period_s = values
    k = share / (1 - share)
    loss = (1 + k) * np.exp(log_loss)
    q = (k - loss) / (k + loss)
    return np.array([k, q, (1 + k) * c, drag, period_s * np.sqrt(1 + k * _stiffness(q))])


def _coordinates(values: Floats) -> Floats:
    k, q, c, drag, period0_s = values
    loss = max(k * (1 - q) / (1 + q), 1e-12)
    return np.array(
        [np.log(loss / (1 + k)), k / (1 + k), c / (1 + k), drag, period0_s / np.sqrt(1 + k * _stiffness(q))]
    )


def _likely(found: StartValues, _: float) -> list[dict[str, float]]:
    decay = found.decay
    out = []
    for exponent in (float(np.clip(decay.p, 0.1, 0.96)), 0.5, 0.9):
        k = max(decay.b, 1e-9) / (decay.p + 1) * (1 + exponent) / (1 - exponent)
        period0_s = found.mean_period_s * np.sqrt(1 + k * _stiffness(np.asarray(exponent)))
        out.append({"k": k, "q": exponent, "c": decay.c, PERIOD: float(period0_s)})
    return out


MASING = branch_law(
    "masing",
    "friction with memory, backbone k φ^q",
    "Al-Bender & De Moerlooze 2008",
    (
        Parameter("k", "k", "rad⁻q", "stiffness of the backbone, over m g R", "f = k φ^q", lower=0.0,
                  logarithmic=True),
        Parameter("q", "q", "1", "exponent of the backbone", "f = k φ^q", lower=0.02, upper=0.999),
        CONSTANT,
        FREE_PERIOD,
    ),
    masing(_backbone, _work, constant=CONSTANT.key),
    {
        "k": Scaling(1.0, -1.0, "q"),
        "q": Scaling(),
        "c": Scaling(1.0),
    },
    Straight(
        _scaled, _coordinates, (HeldColumn(1), HeldColumn(0), HeldColumn(2)), lambda _: {1: (1e-4, 0.6)}
    ),
    _likely,
)  # fmt: skip
