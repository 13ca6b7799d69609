"""Fit of Eq. 5, optionally with a linear term, to the amplitudes."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.contact.decay import decay_path, path_nodes
from processing.contact.drag_coordinates import from_straight, to_straight
from processing.contact.exponent_search import decay_start
from processing.errors import DataError
from processing.least_squares import Loss, Solution, propagate, solve
from processing.swing import TurningPoints

_B, _P, _C, _D = range(4)
"""Columns by name; the last one is always the first amplitude."""


def fit_decay(
    points: TurningPoints, reference: float, mean_period: float, drag: bool, loss: Loss
) -> tuple[Solution, NDArray[np.float64]]:
    """Fit ``dx/ds = -(c + b x^p/(p+1) + d x)`` to the amplitudes.

    Returns the solution with columns b, p, c, (d,) first amplitude, in units of the reference and of
    s = 4 t/T, and the fitted amplitudes in the unit of the points. With d the search runs in the
    coordinates of `straight`.
    """
    x = points.amplitude / reference
    u = points.u_amplitude / reference
    s = (points.time_s - points.time_s[0]) * (4 / mean_period)
    first = decay_start(s, x, u, drag=drag)
    nodes = path_nodes()

    def natural(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """b, p, c, (d,) start, and their derivatives by the solver's columns."""
        out, matrix = values.copy(), np.eye(len(values))
        if drag:
            coordinates = [_B, _P, _D]
            out[_P], out[_D], by = from_straight(*values[coordinates].tolist())
            matrix[_P, coordinates], matrix[_D, coordinates] = by
            out[_B] = matrix[_B, _B] = np.exp(values[_B])
        return out, matrix

    def curve(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        known, matrix = natural(values)
        b, p, c = known[:3]
        if not -0.6 < p < 6.0:
            return np.full_like(x, np.nan), np.full((len(x), len(values)), np.nan)
        d = known[_D] if drag else 0.0
        path, gradient = decay_path(s, known[-1], b / (p + 1), p, c, d, *nodes)
        jacobian = np.empty((len(s), len(values)))
        jacobian[:, _B] = gradient[:, 1] / (p + 1)
        jacobian[:, _P] = gradient[:, 2] - gradient[:, 1] * b / (p + 1) ** 2
        jacobian[:, _C] = gradient[:, 3]
        if drag:
            jacobian[:, _D] = gradient[:, 4]
        jacobian[:, -1] = gradient[:, 0]
        return path, jacobian @ matrix

    def model(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        path, jacobian = curve(values)
        return (path - x) / u, jacobian / u[:, None]

    rate = (x[0] - x[-1]) / (s[-1] - s[0])
    # with a rate of exactly zero the derivative by its exponent would vanish
    b0 = max(first.b * (first.p + 1), 1e-3 * rate)
    lower = np.full(5 if drag else 4, -np.inf)
    upper = np.full(5 if drag else 4, np.inf)
    lower[-1] = 0.1 * x.max()
    if drag:
        # as in the exact fit: if b accounts for several times the whole loss, b and drag merely cancel
        lower[_B], upper[_B] = -30.0, np.log(6 * abs(np.log(x[0] / x[-1])) / (s[-1] - s[0]))
    else:
        lower[_P], upper[_P] = -0.5, 5.0
    # because of noise the best start of the grid may reach zero before the data end: try slower decays
    for slower in (1.0, 0.9, 0.7, 0.5, 0.3, 0.1):
        b, c = b0 * slower, first.c * slower
        start = np.array([b, first.p, c, *([first.d * slower] if drag else []), first.start])
        if drag:
            start[_B] = np.log(b)
            start[_P], start[_D] = to_straight(float(start[_B]), first.p, first.d * slower)
        start = np.clip(start, lower + 1e-9, upper - 1e-9)
        if np.all(np.isfinite(model(start)[0])):
            break
    else:
        raise DataError("the decay has no start from which Eq. 5 reaches the last half-cycle")
    solution = solve(model, start, lower=lower, upper=upper, loss=loss)
    known, matrix = natural(solution.values)
    return (
        replace(
            solution,
            values=known,
            covariance=propagate(matrix, solution.covariance),
            jacobian=solution.jacobian @ np.linalg.inv(matrix),
        ),
        curve(solution.values)[0] * reference,
    )
