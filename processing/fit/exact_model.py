"""The half-swing map as a least-squares model, in coordinates in which its valleys are straight."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import (
    PendulumOnBall,
    cosine_moment,
    quarter_nodes,
    relative_curvature,
    stiffness_ratio,
)
from processing.contact.half_swing_kernel import A0, DRAG, KAPPA, RHO, B, C, N, P, half_swing_map
from processing.fit.result import (
    AMPLITUDE_NAME,
    CONTACT_NAMES,
    DRAG_NAME,
    TIME_NAME,
    UNCALIBRATED_NAMES,
    FitResult,
)
from processing.fit.straight import from_straight, to_straight
from processing.periods import reference_amplitude
from processing.swing import TurningPoints

Array = NDArray[np.float64]

SMALLEST_N = 0.002
"""Below it adhesion takes almost all of the stiffness, and no data tell n from 0."""

STIFFEST = 20.0
"""Factor, either way, between the stiffness with adhesion and that of gravity alone, beyond which
no parameters are tried."""


def moment_and_slope(n: float) -> tuple[float, float]:
    """`cosine_moment` of n + 2 and its derivative by n."""
    step = 1e-5
    slope = (cosine_moment(n + 2 + step) - cosine_moment(n + 2 - step)) / (2 * step)
    return cosine_moment(n + 2), slope


class ExactModel:
    """Residuals and Jacobian of the joint fit, in units of the reference amplitude.

    Natural coordinates: ln b, p, c, n, kappa, (drag,) first amplitude, T0, time of the first
    turning point; drag is ``drag_s w0``, and the logarithm keeps b positive, without which p
    means nothing.

    The solver's columns differ where parameters hide in one another, so that the valley along
    which they do is straight and the search does not have to creep.

    - Adhesion. By harmonic balance it leaves a share ``q = 1 - 2 kappa J`` of the stiffness at
      the reference amplitude (J is `cosine_moment` of n+2). Well determined are the period there,
      ``T0/sqrt(q)``, its slope over ln x, ``s = n kappa J/q``, and the losses against this
      stiffness, ``b/q``, ``c/q``, ``drag/sqrt(q)``; n alone runs along the valley.
    - Drag. With it, b, p and drag are replaced by the coordinates of `straight`, a drag of 1
      counting as pi/4 of linear loss.
    """

    def __init__(self, points: TurningPoints, pendulum: PendulumOnBall | None, *, drag: bool) -> None:
        self.points = points
        self.drag = drag
        self.reference = reference_amplitude(points)
        self.names = (
            *(UNCALIBRATED_NAMES if pendulum is None else CONTACT_NAMES),
            *([DRAG_NAME] if drag else []),
            AMPLITUDE_NAME,
            TIME_NAME,
        )
        self.rho = relative_curvature(pendulum) * self.reference
        self.per_gamma = 1.0 if pendulum is None else stiffness_ratio(1.0, pendulum)
        self._columns = [B, P, C, N, KAPPA, *([DRAG] if drag else []), A0]
        self._index = np.ascontiguousarray(points.index - points.index[0])
        self._nodes = quarter_nodes()
        self._x = points.amplitude / self.reference
        self._u = points.u_amplitude / self.reference
        self.lower = np.full(len(self._columns) + 2, -np.inf)
        self.upper = np.full(len(self._columns) + 2, np.inf)
        self.lower[[0, 3, 4]] = -30.0, SMALLEST_N, -5.0
        self.upper[[0, 3, 4]] = 5.0, 5.0, 5.0
        if drag:
            # b and drag can cancel without end as p nears 1. Where b alone would take several times
            # what is lost, the data have nothing more to say.
            loss = abs(np.log(self._x[0] / self._x[-1])) / self._index[-1]
            self.upper[0] = np.log(6 * loss)
        else:
            self.lower[1], self.upper[1] = -0.5, 5.0
        self.lower[-3] = 1e-3
        self.lower[-2] = 1e-6

    def natural(self, values: Array) -> tuple[Array, Array]:
        """Natural coordinates of the solver's columns, and their derivatives by them."""
        out = values.copy()
        first = np.eye(len(values))
        if self.drag:
            coordinates = [0, 1, 5]
            out[1], linear_drag, by = from_straight(*values[coordinates].tolist())
            out[5] = 4 / np.pi * linear_drag
            first[1, coordinates] = by[0]
            first[5, coordinates] = 4 / np.pi * by[1]
        n, s = values[3], values[4]
        whole = n + 2 * s
        if not n / STIFFEST < whole < n * STIFFEST:
            return np.full_like(values, np.nan), first
        moment, by_n = moment_and_slope(n)
        q = n / whole
        log_q = np.array([2 * s / (n * whole), -2 / whole])  # derivatives of ln q by n and s
        second = np.eye(len(values))
        out[0] += np.log(q)
        second[0, 3:5] = log_q
        for place, power in ((2, 1.0), (-2, 0.5), *([(5, 0.5)] if self.drag else [])):
            out[place] *= q**power
            second[place, 3:5] = power * out[place] * log_q
            second[place, place] = q**power
        out[4] = s / (whole * moment)
        second[4, 3] = -out[4] * (1 / whole + by_n / moment)
        second[4, 4] = n / (whole**2 * moment)
        return out, second @ first

    def columns(self, natural: Array) -> Array:
        """The solver's columns of natural coordinates."""
        out = natural.copy()
        share = natural[4] * cosine_moment(natural[3] + 2)
        q = 1 - 2 * share
        out[0] -= np.log(q)
        out[2] /= q
        out[4] = natural[3] * share / q
        out[-2] /= np.sqrt(q)
        if self.drag:
            out[1], out[5] = to_straight(float(out[0]), natural[1], np.pi / 4 * natural[5] / np.sqrt(q))
        return out

    def _run(self, natural: Array) -> tuple[Array, Array, Array, Array]:
        q = np.zeros(8)
        q[self._columns] = natural[:-2]
        q[B] = np.exp(natural[0])
        q[RHO] = self.rho
        if not (-0.6 < q[P] < 6.0 and np.all(np.isfinite(q))):
            nothing = np.full((len(self._x), len(q)), np.nan)
            return nothing[:, 0], nothing[:, 0], nothing, nothing
        amplitude, tau, by_amplitude, by_tau, _ = half_swing_map(q, self._index, *self._nodes)
        return amplitude, tau, by_amplitude, by_tau

    def curve(self, values: Array) -> tuple[Array, Array, Array, Array]:
        """Amplitude (of the reference), time (s) and the derivatives of both by the columns."""
        natural, matrix = self.natural(values)
        t0, start = natural[-2:]
        amplitude, tau, by_amplitude, by_tau = self._run(natural)
        amplitude_jacobian = np.zeros((len(amplitude), len(values)))
        time_jacobian = np.empty((len(amplitude), len(values)))
        amplitude_jacobian[:, :-2] = by_amplitude[:, self._columns]
        time_jacobian[:, :-2] = t0 * by_tau[:, self._columns]
        time_jacobian[:, -2] = tau
        time_jacobian[:, -1] = 1.0
        for jacobian in (amplitude_jacobian, time_jacobian):
            jacobian[:, 0] *= np.exp(natural[0])
        return amplitude, start + t0 * tau, amplitude_jacobian @ matrix, time_jacobian @ matrix

    def __call__(self, values: Array) -> tuple[Array, Array]:
        amplitude, time, amplitude_jacobian, time_jacobian = self.curve(values)
        residuals = np.concatenate(
            [(amplitude - self._x) / self._u, (time - self.points.time_s) / self.points.u_time_s]
        )
        jacobian = np.concatenate(
            [amplitude_jacobian / self._u[:, None], time_jacobian / self.points.u_time_s[:, None]]
        )
        return residuals, jacobian

    def by_log_rho(self, values: Array, jacobian: Array) -> Array:
        """How the fitted columns move with ln(R/a): least squares' answer to the map's derivative."""
        natural, _ = self.natural(values)
        _, _, by_amplitude, by_tau = self._run(natural)
        change = self.rho * np.concatenate(
            [by_amplitude[:, RHO] / self._u, natural[-2] * by_tau[:, RHO] / self.points.u_time_s]
        )
        return np.asarray(-np.linalg.lstsq(jacobian, change, rcond=1e-12)[0], dtype=np.float64)

    def physical(self, values: Array) -> tuple[tuple[str, ...], Array, Array]:
        """Names, values in SI units and the derivatives of these by the columns."""
        natural, matrix = self.natural(values)
        log_b, p, c, n, kappa = natural[:5]
        start, t0, first_time = natural[-3:]
        reference, log_r = self.reference, np.log(self.reference)
        names = self.names
        out = np.empty(len(names))
        with np.errstate(over="ignore"):
            # a trial step may lie anywhere; what overflows is refused by whoever asked
            b = np.exp(log_b + (1 - p) * log_r)
            gamma_factor = np.exp(-n * log_r) / self.per_gamma
        out[:6] = b, p, c * reference, n, t0, kappa * gamma_factor
        out[-2:] = start * reference, first_time
        jacobian = np.zeros((len(names), len(names)))
        jacobian[0, 0], jacobian[0, 1] = out[0], -log_r * out[0]
        jacobian[1, 1] = 1.0
        jacobian[2, 2] = reference
        jacobian[3, 3] = 1.0
        jacobian[4, -2] = 1.0
        jacobian[5, 4], jacobian[5, 3] = gamma_factor, -log_r * out[5]
        jacobian[-2, -3] = reference
        jacobian[-1, -1] = 1.0
        if self.drag:
            out[6] = natural[5] * t0 / (2 * np.pi)
            jacobian[6, 5] = t0 / (2 * np.pi)
            jacobian[6, -2] = natural[5] / (2 * np.pi)
        with np.errstate(over="ignore", invalid="ignore"):
            return names, out, jacobian @ matrix

    def columns_of(self, result: FitResult) -> Array:
        """The solver's columns of a finished exact fit of the same points."""
        known = result.parameters
        r = self.reference
        drag = [known.drag_s * 2 * np.pi / known.period0_s] if self.drag else []
        natural = [
            np.log(known.b) + (known.p - 1) * np.log(r),
            known.p,
            known.c / r,
            known.n,
            result.estimate(self.names[5]).value * self.per_gamma * r**known.n,
            *drag,
            result.estimate(AMPLITUDE_NAME).value / r,
            known.period0_s,
            result.estimate(TIME_NAME).value,
        ]
        return self.columns(np.array(natural))
