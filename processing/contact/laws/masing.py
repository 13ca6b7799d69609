"""Laws with memory by Masing's rule: a backbone f(phi) that is doubled on every branch.

    M = M_reversal - 2 m g R f(s/2) - m g R c sign(phi'),    s the angle since the reversal

Rolling: ``f = k phi^q``, as Al-Bender & De Moerlooze (2008) find it before gross slip. Per cycle it takes
``4 k (1-q)/(1+q) A^(q+1)``, as b of Eq. 1 does with p = q and b = k (1-q), and it makes the period depend on
the amplitude without any further parameter.

Maxwell slip: springs in parallel, each of which slips beyond an angle of its own,

    f = sum k_i min(phi, phi_i),    phi_i = 4, 12, 36, 90 arcsec

Any backbone that rises ever less is such a sum; this one asks nothing of its shape but four stiffnesses.
Where a slider begins to slip, the loss of a half-swing has a kink over the amplitude. The table of
half-swings rounds it, by 2e-5 of amplitude and time; the derivatives by the stiffnesses are off by 3 to 5 %
there, and so may be uncertainties that hang on these amplitudes.
"""

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues, cosine_moment
from processing.contact.coordinates import ComplexOrReal, Scaling, Straight, logarithms_of
from processing.contact.law import CONSTANT, FREE_PERIOD, PERIOD, HeldColumn, Parameter
from processing.contact.memory import Arrays, branch_law, masing


def _backbone(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** q["q"])


def _work(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** (q["q"] + 1) / (q["q"] + 1))


def _stiffness(q: ComplexOrReal) -> ComplexOrReal:
    """Moment in phase with a swing of amplitude 1, for k = 1."""
    return np.asarray(8 / np.pi * cosine_moment(2 * q) * q / (q + 1))


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


YIELD_ARCSEC = (4.0, 12.0, 36.0, 90.0)
"""By factors of about three through the swings of the paper's runs, 124 to 2 arcsec."""
_YIELD_RAD = tuple(np.deg2rad(angle / 3600).item() for angle in YIELD_ARCSEC)
_KEYS = tuple(f"k{number}" for number in range(1, len(YIELD_ARCSEC) + 1))


def _slip_backbone(x: Floats, q: Arrays) -> Floats:
    total = sum(q[key] * np.minimum(x, y / q["reference"]) for key, y in zip(_KEYS, _YIELD_RAD, strict=True))
    return np.asarray(total)


def _slip_work(x: Floats, q: Arrays) -> Floats:
    total: Floats = np.zeros(())
    for key, y_rad in zip(_KEYS, _YIELD_RAD, strict=True):
        y = y_rad / q["reference"]
        total = total + q[key] * np.where(x < y, 0.5 * x * x, y * (x - 0.5 * y))
    return np.asarray(total)


def _slip_likely(found: StartValues, reference_rad: float) -> list[dict[str, float]]:
    from scipy.optimize import nnls

    decay = found.decay
    a = np.geomspace(0.2, 5.0, 30)
    loss = 2 * (decay.c + decay.b * a**decay.p / (decay.p + 1))
    unit = {key: np.zeros(()) for key in _KEYS} | {"reference": np.array(reference_rad)}
    columns = [np.full_like(a, 2.0)]
    for key in _KEYS:
        one = {**unit, key: np.ones(())}
        columns.append(4 * _slip_work(a, one) / a - 2 * _slip_backbone(a, one))
    solution, _ = nnls(np.column_stack(columns) / loss[:, None], np.ones_like(a))
    c, *stiffness = solution.tolist()
    period0_s = found.mean_period_s * np.sqrt(1 + min(sum(stiffness), 1.0))
    return [{"c": c, **dict(zip(_KEYS, stiffness, strict=True)), PERIOD: period0_s}]


MAXWELL_SLIP = branch_law(
    "maxwell-slip",
    "four springs that slip, with memory",
    "Iwan 1966",
    (
        *(
            Parameter(key, f"k{'₁₂₃₄'[i]}", "rad⁻¹", f"stiffness that slips at {YIELD_ARCSEC[i]:g} arcsec",
                      "f = Σ k min(φ, φ_i)", lower=0.0)
            for i, key in enumerate(_KEYS)
        ),
        CONSTANT,
        FREE_PERIOD,
    ),
    masing(_slip_backbone, _slip_work, constant=CONSTANT.key),
    {**{key: Scaling() for key in _KEYS}, "c": Scaling(1.0)},
    logarithms_of(),
    _slip_likely,
    in_angles=True,
)  # fmt: skip
