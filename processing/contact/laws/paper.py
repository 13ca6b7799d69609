"""The paper's law: friction of Eq. 1, elastic adhesion of Eq. 3.

    M_fr = -m g R (c + b |phi|^p) sign(phi')                                      (1)
    M_el = 2 gamma a^2 R |phi|^(n+1) (pi/2 - (R/a) |phi|) sign(phi)               (3)

In the units of the map, ``x = phi / reference``, the coefficients are ``b = b reference^(p-1)``,
``c = c / reference``, ``kappa = 2 gamma a^2/(m g) reference^n`` and ``rho = R reference / a``.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.asymptotic import (
    PeriodStart,
    StartValues,
    cosine_moment,
    from_valley_coordinates,
    to_valley_coordinates,
)
from processing.contact.coordinates import ComplexOrReal, Scaling, ValleyCoordinates
from processing.contact.law import (
    DRAG,
    PERIOD,
    ContactParameters,
    HeldColumn,
    Parameter,
    PendulumOnBall,
    relative_curvature,
    stiffness_ratio,
)
from processing.contact.memoryless import Moment, Moments, memoryless_law
from processing.errors import DataError

STIFFNESS = Scaling(0.0, -1.0, "n", lambda pendulum: stiffness_ratio(1.0, pendulum), loses=False)
"""Scaling of gamma, which is fitted as kappa."""
_P_RANGE = (-0.5, 5.0)
_N_RANGE = (1e-5, 5.0)
"""At n = 0 itself adhesion would be a spring, which only the term of R/a in Eq. 3 tells from gravity."""
_MAX_STIFFNESS_RATIO = 20.0
"""Largest factor, in either direction, between the stiffness with adhesion and that of gravity alone for
which parameters are tried."""

_START_KAPPAS = (-0.5, 0.63)
"""Range of kappa at starts: at 2/pi = 0.637 and n = 0 adhesion cancels all of the stiffness."""


def friction_moment(b: float, p: float, c: float) -> Moment:
    """Eq. 1."""

    def moment(x: Floats) -> Floats:
        return np.asarray(b * x**p + c)

    def work(x: Floats) -> Floats:
        power = x ** (p + 1) / (p + 1)
        return np.array([b * power + c * x, power, b * power * (np.log(x) - 1 / (p + 1)), x])

    return Moment((0, 1, 2), moment, work)


def elastic_moment(n: float, kappa: float, rho: float, parameter_indices: tuple[int, ...]) -> Moment:
    """Eq. 3; its parameters are n, kappa and R/a."""

    def moment(x: Floats) -> Floats:
        return np.asarray(kappa * x ** (n + 1) * (0.5 * pi - rho * x))

    def work(x: Floats) -> Floats:
        log_x, power = np.log(x), x ** (n + 2)
        first, second = 0.5 * pi / (n + 2) * power, power * x / (n + 3)
        unit = first - rho * second
        n_derivative = first * (log_x - 1 / (n + 2)) - rho * second * (log_x - 1 / (n + 3))
        return np.array([kappa * unit, kappa * n_derivative, unit, -kappa * second])

    return Moment(parameter_indices, moment, work)


def _moments(parameters: Floats, _: float, __: float) -> Moments | None:
    b, p, c, n, kappa, _drag, _reference, rho = parameters.tolist()
    if not (n > -1.5 and -0.6 < p < 6.0):
        return None
    return Moments(friction_moment(b, p, c), elastic_moment(n, kappa, rho, (3, 4, 7)))


def _valley_coordinates(drag: bool) -> ValleyCoordinates:
    """Coordinates that differ from the parameters where these are strongly correlated.

    - Adhesion. By harmonic balance it leaves the fraction ``q = 1 - 2 kappa J`` of the stiffness at the
      reference amplitude (J is `cosine_moment` of n+2). The data determine well the period there,
      ``T0/sqrt(q)``, its slope against ln x, ``s = n kappa J/q``, and the losses relative to this
      stiffness, ``b/q``, ``c/q``, ``drag/sqrt(q)``. Only n varies along the valley.
    - b is searched as its logarithm, which keeps it positive; at b = 0, p would be undefined.
    - Drag. If it is fitted, b, p and drag are replaced by the coordinates of `to_valley_coordinates`; a drag
      of 1 corresponds to a linear loss of pi/4.
    """

    def scaled(values: ComplexOrReal) -> ComplexOrReal:
        log_b, p, c, n, s, air, period_s = values
        b = np.exp(log_b)
        if drag:
            p, air = from_valley_coordinates(b, p, air)
        # q = n/(n + 2 s) from s = n kappa J/q and q = 1 - 2 kappa J
        q = n / (n + 2 * s)
        kappa = s / ((n + 2 * s) * cosine_moment(n + 2))
        out = np.array([q * b, p, q * c, n, kappa, 4 / pi * np.sqrt(q) * air, np.sqrt(q) * period_s])
        is_tried = np.abs(np.log(q.real)) < np.log(_MAX_STIFFNESS_RATIO)
        return np.where(is_tried, out, np.nan)

    def coordinates(values: Floats) -> Floats:
        b, p, c, n, kappa, air, period_s = values.tolist()
        kappa_j = kappa * float(cosine_moment(n + 2))
        q = 1 - 2 * kappa_j
        air *= 0.25 * pi / np.sqrt(q)
        if drag:
            p, air = to_valley_coordinates(b / q, p, air)
        with np.errstate(divide="ignore"):
            return np.array([np.log(b / q), p, c / q, n, n * kappa_j / q, air, period_s / np.sqrt(q)])

    def limits(loss: float) -> dict[int, tuple[float, float]]:
        ranges = {0: (-30.0, 5.0), 1: _P_RANGE, 3: _N_RANGE, 4: (-5.0, 5.0)}
        if drag:
            # as p approaches 1, b and drag can cancel each other at arbitrarily large values
            del ranges[1]
            ranges[0] = (-30.0, float(np.log(6 * loss)))
        return ranges

    def at_limit(values: Floats) -> list[int]:
        stiffness = 1 - 2 * values[4] * cosine_moment(values[3] + 2)
        return [] if np.abs(np.log(stiffness)) < np.log(0.9 * _MAX_STIFFNESS_RATIO) - 1e-4 else [4]

    # the valley of a drag runs along ln b, so that b is held by means of p's column; the column of adhesion
    # has the sign of gamma, which a Newton step must not change
    held = (HeldColumn(int(drag)), *map(HeldColumn, (1, 2, 3)), HeldColumn(4, keeps_sign=True))
    return ValleyCoordinates(scaled, coordinates, held, limits, 0 if drag else None, at_limit)


def _propose_starts(start: StartValues, _: float) -> list[dict[str, float]]:
    """Start values by Eqs. 5 and 6: exponents n that fit the periods best, then without adhesion.

    They are the best three, and of those with a positive gamma the best and that of the smallest n: with a
    small n the term of R/a in Eq. 3 resembles a negative gamma with n = 1. Eq. 5 neglects that adhesion
    reduces the restoring moment, so that its rates are converted to those of the exact map.
    """
    decay, proposals = start.decay, []
    positive = [k for k, period in enumerate(start.periods) if period.kappa > 0]
    smallest = sorted(positive, key=lambda k: start.periods[k].n)
    chosen = sorted({*range(min(3, len(start.periods))), *positive[:1], *smallest[:1]})
    for period in [*(start.periods[k] for k in chosen), PeriodStart(start.mean_period_s, 0.5, 0.0)]:
        period0_s, kappa = _by_harmonic_balance(period)
        stiffness = (period0_s / start.mean_period_s) ** 2
        factor = stiffness if 1 / _MAX_STIFFNESS_RATIO < stiffness < _MAX_STIFFNESS_RATIO else 1.0
        proposals.append(
            {
                "b": max(decay.b * factor, 1e-9),
                "p": float(np.clip(decay.p, 0.1, 3.0)),
                "c": decay.c * factor,
                "n": period.n,
                "gamma_pa": float(np.clip(kappa, *_START_KAPPAS)),
                DRAG.key: decay.d * 4 / pi,
                PERIOD: period0_s,
            }
        )
    return proposals


def _by_harmonic_balance(period: PeriodStart) -> tuple[float, float]:
    """T0 and kappa of ``(T0/T)^2 = 1 - 2 kappa J x^n`` with the period, and its slope, of Eq. 6 at x = 1.

    Eq. 6 is its first order in kappa, too little where adhesion cancels much of the stiffness.
    """
    drop = period.kappa * float(cosine_moment(period.n + 2))
    per_stiffness = 1 / max((1 - drop) * (1 + drop), 1 / _MAX_STIFFNESS_RATIO)
    return period.period0_s * per_stiffness**0.5, period.kappa * (1 - drop) * per_stiffness


PAPER = memoryless_law(
    "paper",
    "friction c + b|φ|ᵖ and elastic adhesion",
    "Eqs. 1 and 3",
    (
        Parameter("b", "b", "rad⁻ᵖ", "friction inside the contact, over m g R", "Eq. 1", lower=0.0,
                  logarithmic=True),
        Parameter("p", "p", "1", "exponent of the friction", "Eq. 1", *_P_RANGE),
        Parameter("c", "c", "1", "friction by adhesion, over m g R", "Eq. 1", lower=0.0),
        Parameter("n", "n", "1", "exponent of the elastic adhesion", "Eq. 3", *_N_RANGE),
        Parameter("period0_s", "T₀", "s", "period at vanishing amplitude", "Eq. 6", lower=0.0),
        Parameter("gamma_pa", "γ", "Pa", "stiffness of the elastic adhesion", "Eq. 3", lower=0.0,
                  logarithmic=True, shown="MPa"),
    ),
    _moments,
    {"b": Scaling(1.0, -1.0, "p"), "p": Scaling(), "c": Scaling(1.0), "n": Scaling(), "gamma_pa": STIFFNESS},
    _valley_coordinates,
    _propose_starts,
)  # fmt: skip


class ScaledContact(NamedTuple):
    """The law's parameters in units of a reference amplitude; ``drag = drag_s w0``."""

    b: float
    p: float
    c: float
    n: float
    kappa: float
    drag: float
    rho: float


def scaled_contact(
    parameters: ContactParameters, pendulum: PendulumOnBall, reference_rad: float
) -> ScaledContact:
    """SI parameters in the units of a reference amplitude."""
    return ScaledContact(
        b=parameters.b * reference_rad ** (parameters.p - 1),
        p=parameters.p,
        c=parameters.c / reference_rad,
        n=parameters.n,
        kappa=stiffness_ratio(parameters.gamma_pa, pendulum) * reference_rad**parameters.n,
        drag=parameters.drag_s * 2 * pi / parameters.period0_s,
        rho=relative_curvature(pendulum) * reference_rad,
    )


def turning_points_of(
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    initial_amplitude_rad: float,
    half_cycles: int,
) -> tuple[Floats, Floats]:
    """Amplitudes (rad) and times (s) of the first turning points of a free decay.

    Parameters
    ----------
    initial_amplitude_rad
        The first turning point, at time 0; positive.
    half_cycles
        Number of half-cycles after it; the arrays have one element more.

    Returns
    -------
    amplitude_rad, time_s
        Shape ``(half_cycles + 1,)``. NaN from the turning point at which the pendulum sticks
        (friction holds it) onwards.
    """
    if not initial_amplitude_rad > 0:
        raise DataError(f"initial amplitude {initial_amplitude_rad} rad: it must be positive")
    index = np.arange(half_cycles + 1, dtype=np.int64)
    *scaled, rho = scaled_contact(parameters, pendulum, initial_amplitude_rad)
    points = PAPER.turning_points(np.array([*scaled, initial_amplitude_rad, rho, 1.0]), index)
    return points.amplitude * initial_amplitude_rad, points.time * parameters.period0_s
