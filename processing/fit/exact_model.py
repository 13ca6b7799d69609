"""A law's half-swing map as a least-squares model of amplitudes and times."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall
from processing.contact.laws import PAPER, Law
from processing.fit.result import FitResult
from processing.swing import TurningPoints

Array = NDArray[np.float64]


class ExactModel:
    """Residuals and Jacobian of the joint fit, for the solver's columns of a law.

    Raises
    ------
    DataError
        The law cannot be fitted with a drag, or to these points.
    """

    def __init__(
        self, points: TurningPoints, pendulum: PendulumOnBall | None, *, law: Law = PAPER, drag: bool = False
    ) -> None:
        self.points = points
        self.law = law
        self.names = law.fit_names(calibrated=pendulum is not None, drag=drag)
        self.columns = law.columns(points, pendulum, self.names)
        self.reference = self.columns.reference
        self.lower, self.upper = self.columns.lower, self.columns.upper
        self._index = np.ascontiguousarray(points.index - points.index[0])
        self._x = points.amplitude / self.reference
        self._u = points.u_amplitude / self.reference

    def curve(self, columns: Array) -> tuple[Array, Array, Array, Array]:
        """Amplitude (in units of the reference), time (s), and the derivatives of both by the columns.

        With the columns v, the map's parameters q(v) and its time tau in units of T0:
        ``t = t_0 + T0 tau``, ``dt/dv = T0 dtau/dq dq/dv + tau dT0/dv + dt_0/dv``.
        """
        parameters, matrix = self.columns.map_parameters(columns)
        if not np.all(np.isfinite(parameters)):
            nothing = np.full((len(self._x), len(columns)), np.nan)
            return nothing[:, 0], nothing[:, 0], nothing, nothing
        period0_s, first_time_s = parameters[-2:]
        found = self.law.half_swing_map(parameters[:-2], self._index)
        amplitude_jacobian = found.amplitude_gradient @ matrix[:-2]
        time_jacobian = period0_s * (found.time_gradient @ matrix[:-2])
        time_jacobian += found.time[:, None] * matrix[-2] + matrix[-1]
        return found.amplitude, first_time_s + period0_s * found.time, amplitude_jacobian, time_jacobian

    def __call__(self, columns: Array) -> tuple[Array, Array]:
        """Residuals divided by their standard uncertainties, and their derivatives by the columns."""
        amplitude, time, amplitude_jacobian, time_jacobian = self.curve(columns)
        residuals = np.concatenate(
            [(amplitude - self._x) / self._u, (time - self.points.time_s) / self.points.u_time_s]
        )
        jacobian = np.concatenate(
            [amplitude_jacobian / self._u[:, None], time_jacobian / self.points.u_time_s[:, None]]
        )
        return residuals, jacobian

    def starts(self) -> list[Array]:
        """Start values for which the map reaches the last half-cycle, the most promising first."""
        usable = []
        for attempts in self.columns.starts(self.points):
            for attempt in attempts:
                columns = np.clip(attempt, self.lower + 1e-9, self.upper - 1e-9)
                if np.all(np.isfinite(self(columns)[0])):
                    usable.append(columns)
                    break
        return usable

    def by_log_rho(self, columns: Array, jacobian: Array) -> Array:
        """Derivative of the fitted columns by ln(R/a), by linearised least squares."""
        parameters, _ = self.columns.map_parameters(columns)
        found = self.law.half_swing_map(parameters[:-2], self._index)
        by_rho = self.columns.map_by_log_rho
        change = np.concatenate(
            [
                found.amplitude_gradient @ by_rho / self._u,
                parameters[-2] * (found.time_gradient @ by_rho) / self.points.u_time_s,
            ]
        )
        return np.asarray(-np.linalg.lstsq(jacobian, change, rcond=1e-12)[0], dtype=np.float64)

    def columns_of(self, result: FitResult) -> Array:
        """The solver's columns of a finished exact fit of the same points."""
        return self.columns.from_physical({name: result.estimate(name).value for name in self.names})
