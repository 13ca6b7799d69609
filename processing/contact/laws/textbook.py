"""Laws of the literature, with and without memory of the last reversal.

- Coulomb: M = -m g R c sign(phi').
- Viscous: M = -m g R drag_s phi'.
- Dahl: dM/ds = sigma m g R (1 - M/(m g R c)), s the angle since the reversal.
- Masing's rule: a backbone f doubled on every branch, M = M_reversal - 2 m g R f(s/2) - m g R c sign(phi').
  Rolling before gross slip has f = k phi^q (Al-Bender & De Moerlooze 2008), springs that slip one after the
  other (Maxwell) f = sum k_i min(phi, phi_i).
"""

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import StartValues, cosine_moment
from processing.contact.coordinates import ComplexOrReal, Scaling, ValleyCoordinates, logarithms_of
from processing.contact.hysteresis import Arrays, Branch, branch_law, masing_branch
from processing.contact.law import CONSTANT, DRAG, FREE_PERIOD, PERIOD, HeldColumn, Parameter
from processing.contact.memoryless import NO_MOMENT, Moment, Moments, memoryless_law


def _rate(start: StartValues) -> float:
    """Rate of the decay at the reference amplitude."""
    return start.decay.c + max(start.decay.b, 0.0) / (start.decay.p + 1)


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
    lambda start, _: [{"c": _rate(start), PERIOD: start.mean_period_s}],
)


VISCOUS = memoryless_law(
    "viscous",
    "linear drag alone",
    "Stokes",
    (DRAG, FREE_PERIOD),
    lambda parameters, _, __: Moments(NO_MOMENT, NO_MOMENT),
    {},
    lambda _: logarithms_of(),
    lambda start, _: [{DRAG.key: 4 / np.pi * _rate(start), PERIOD: start.mean_period_s}],
)


def _resistance(s: Floats, turn_moment: Floats, q: Arrays) -> Floats:
    return np.asarray(q["c"] - (turn_moment + q["c"]) * np.exp(-s * q["sigma"] / q["c"]))


def _mean_resistance(s: Floats, turn_moment: Floats, q: Arrays) -> Floats:
    x = s * q["sigma"] / q["c"]
    return np.asarray(q["c"] + (turn_moment + q["c"]) * np.expm1(-x) / x)


def _reversal_moment(amplitude: Floats, q: Arrays) -> Floats:
    return np.asarray(q["c"] * np.tanh(amplitude * q["sigma"] / q["c"]))


def _dahl_starts(start: StartValues, _: float) -> list[dict[str, float]]:
    loss = 2 * (start.decay.c + start.decay.b / (start.decay.p + 1))  # at the reference amplitude
    proposals = []
    for angle in (0.05, 0.5, 3.0, 20.0):  # c/sigma in units of the reference
        unit_loss = 2 * (1 - np.tanh(1 / angle) * angle)
        c = max(loss, 1e-9) / max(unit_loss, 1e-9)
        period0_s = start.mean_period_s * np.sqrt(1 + min(c, 1.0))
        proposals.append({"c": c, "sigma": c / angle, PERIOD: period0_s})
    return proposals


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
    Branch(_resistance, _mean_resistance, _reversal_moment),
    {"c": Scaling(1.0), "sigma": Scaling()},
    logarithms_of(0, 1),
    _dahl_starts,
)  # fmt: skip


def _backbone(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** q["q"])


def _work(x: Floats, q: Arrays) -> Floats:
    return np.asarray(q["k"] * x ** (q["q"] + 1) / (q["q"] + 1))


def _stiffness(q: ComplexOrReal) -> ComplexOrReal:
    """Moment in phase with a swing of amplitude 1, for k = 1."""
    return np.asarray(8 / np.pi * cosine_moment(2 * q) * q / (q + 1))


def _scaled(values: ComplexOrReal) -> ComplexOrReal:
    """k, q, c, drag and T0 from what decay and period determine: ln of the loss, the contact's fraction of
    the stiffness, c over the stiffness, the drag, and the period at the reference amplitude."""
    log_loss, fraction, c, drag, period_s = values
    k = fraction / (1 - fraction)
    loss = (1 + k) * np.exp(log_loss)
    q = (k - loss) / (k + loss)
    return np.array([k, q, (1 + k) * c, drag, period_s * np.sqrt(1 + k * _stiffness(q))])


def _coordinates(values: Floats) -> Floats:
    k, q, c, drag, period0_s = values
    loss = max(k * (1 - q) / (1 + q), 1e-12)
    return np.array(
        [np.log(loss / (1 + k)), k / (1 + k), c / (1 + k), drag, period0_s / np.sqrt(1 + k * _stiffness(q))]
    )


def _masing_starts(start: StartValues, _: float) -> list[dict[str, float]]:
    decay, proposals = start.decay, []
    for exponent in (float(np.clip(decay.p, 0.1, 0.96)), 0.5, 0.9):
        k = max(decay.b, 1e-9) / (decay.p + 1) * (1 + exponent) / (1 - exponent)
        period0_s = start.mean_period_s * np.sqrt(1 + k * _stiffness(np.asarray(exponent)))
        proposals.append({"k": k, "q": exponent, "c": decay.c, PERIOD: float(period0_s)})
    return proposals


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
    masing_branch(_backbone, _work, constant=CONSTANT.key),
    {"k": Scaling(1.0, -1.0, "q"), "q": Scaling(), "c": Scaling(1.0)},
    ValleyCoordinates(
        _scaled, _coordinates, (HeldColumn(1), HeldColumn(0), HeldColumn(2)), lambda _: {1: (1e-4, 0.6)}
    ),
    _masing_starts,
)  # fmt: skip


YIELD_ARCSEC = (4.0, 12.0, 36.0, 90.0)
"""Angles phi_i at which springs slip, by factors of about three through the swings of the paper's runs.

At each of them the loss has a kink over the amplitude. The table of half-cycles rounds it, by 2e-5 of
amplitude and time; derivatives with respect to the stiffnesses are wrong by 3 to 5 % there."""
_YIELD_RAD = tuple(np.deg2rad(angle / 3600).item() for angle in YIELD_ARCSEC)
_KEYS = tuple(f"k{number}" for number in range(1, len(YIELD_ARCSEC) + 1))


def _slip_backbone(x: Floats, q: Arrays) -> Floats:
    yields = zip(_KEYS, _YIELD_RAD, strict=True)
    return np.asarray(sum(q[key] * np.minimum(x, y_rad / q["reference"]) for key, y_rad in yields))


def _slip_work(x: Floats, q: Arrays) -> Floats:
    total: Floats = np.zeros(())
    for key, y_rad in zip(_KEYS, _YIELD_RAD, strict=True):
        y = y_rad / q["reference"]
        total = total + q[key] * np.where(x < y, 0.5 * x * x, y * (x - 0.5 * y))
    return np.asarray(total)


def _slip_starts(start: StartValues, reference_rad: float) -> list[dict[str, float]]:
    from scipy.optimize import nnls

    decay = start.decay
    a = np.geomspace(0.2, 5.0, 30)
    loss = 2 * (decay.c + decay.b * a**decay.p / (decay.p + 1))
    zero = {key: np.zeros(()) for key in _KEYS} | {"reference": np.array(reference_rad)}
    columns = [np.full_like(a, 2.0)]
    for key in _KEYS:
        unit = {**zero, key: np.ones(())}
        columns.append(4 * _slip_work(a, unit) / a - 2 * _slip_backbone(a, unit))
    solution, _ = nnls(np.column_stack(columns) / loss[:, None], np.ones_like(a))
    c, *stiffness = solution.tolist()
    period0_s = start.mean_period_s * np.sqrt(1 + min(sum(stiffness), 1.0))
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
    masing_branch(_slip_backbone, _slip_work, constant=CONSTANT.key),
    dict.fromkeys(_KEYS, Scaling()) | {"c": Scaling(1.0)},
    logarithms_of(),
    _slip_starts,
)  # fmt: skip
