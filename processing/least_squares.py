"""Weighted nonlinear least squares with a reliable covariance, for all fits.

Values and standard errors are tested against the certified ones of NIST's Statistical Reference Datasets.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError

Loss = Literal["linear", "soft_l1", "huber", "cauchy"]
Model = Callable[[Floats], tuple[Floats, Floats]]
"""Function from values to residuals over their standard uncertainties, and their Jacobian.

Residuals that are not finite make the solver shorten its step."""

_ROUND_EVALUATIONS = 60
"""Number of evaluations after which the progress is checked."""
_FLAT_COST = 0.01
"""The search ends if a round reduces the cost by less than this, in units of chi2/2 per residual; the
remaining distance to the minimum is a small fraction of a standard uncertainty."""
_FLAT_COST_AT_LAST = 0.2
"""The same for the last round: parameters that the data hardly determine have a valley without an end."""
_STUCK_SHARE = 0.5
"""The search has found no minimum if one linear step would still remove a larger share of the cost."""
_LOSS_SCALE = 1.5
"""Standard uncertainties above about which a robust loss reduces the influence of a residual."""
_SMALLEST_SINGULAR_VALUE = 1e-13
"""Singular values below this fraction of the largest (columns scaled to unit length) are treated as zero."""


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of a fit."""

    values: Floats
    covariance: Floats
    """By the stated uncertainties of the data, not scaled by chi2; that of the M-estimator if robust.
    Parameters that the data do not determine have infinite variances."""
    residuals: Floats
    """Residuals over their standard uncertainties, without the loss."""
    jacobian: Floats
    cost: float
    """Half of the sum of the loss."""
    converged: bool
    message: str

    @property
    def chi2(self) -> float:
        return float(self.residuals @ self.residuals)

    @property
    def dof(self) -> int:
        return len(self.residuals) - len(self.values)


def solve(
    model: Model,
    start: Floats,
    *,
    lower: Floats | None = None,
    upper: Floats | None = None,
    loss: Loss = "linear",
    max_evaluations: int = 300,
    cost_tolerance: float = 1e-12,
) -> Solution:
    """Minimise the sum of squares (or of a robust loss) of the model's residuals.

    Parameters
    ----------
    cost_tolerance
        Relative reduction of the cost below which the search ends.

    Raises
    ------
    DataError
        The model has no finite value at the start of the search.

    Returns
    -------
    Solution
        `converged` is False if the number of evaluations was exhausted or no step was possible; the values
        are then the best ones found and not a minimum.
    """
    # imported here because the settings import modules of processing, and scipy would slow down every command
    from scipy.optimize import least_squares

    # The solver requests the Jacobian at the point of the step just accepted, mostly the last one evaluated:
    # caching one evaluation saves half of them.
    cached: dict[bytes, tuple[Floats, Floats]] = {}

    def evaluate(values: Floats) -> tuple[Floats, Floats]:
        key = values.tobytes()
        if key not in cached:
            cached.clear()
            cached[key] = model(values)
        return cached[key]

    def residuals_at(values: Floats) -> Floats:
        return evaluate(values)[0]

    def jacobian_at(values: Floats) -> Floats:
        return evaluate(values)[1]

    values = np.asarray(start, dtype=np.float64)
    cost, evaluations_left, converged, message = np.inf, max_evaluations, False, "no step made"
    while evaluations_left > 0 and not converged:
        try:
            result = least_squares(
                residuals_at,
                values,
                jac=jacobian_at,
                bounds=(-np.inf if lower is None else lower, np.inf if upper is None else upper),
                x_scale="jac",
                loss=loss,
                f_scale=_LOSS_SCALE,
                xtol=1e-12,
                ftol=cost_tolerance,
                gtol=1e-14,
                max_nfev=min(evaluations_left, _ROUND_EVALUATIONS),
            )
        except ValueError as error:
            # the solver begins a step inside the bounds, where the model need not have a value
            if "finite" not in str(error):
                raise
            raise DataError(f"a fit cannot begin there: {error}") from None
        evaluations_left -= int(result.nfev)
        values, message = np.asarray(result.x, dtype=np.float64), str(result.message)
        if result.status > 0 and _is_stuck(result):
            message = "no further step was possible: the model has no value beyond"
            break
        fall, cost = cost - float(result.cost), float(result.cost)
        flat = _FLAT_COST if evaluations_left > 0 else _FLAT_COST_AT_LAST
        if result.status > 0:
            converged = True
        elif fall < flat * cost / len(result.fun):
            converged, message = True, "a valley too flat for further steps to matter"
    residuals, jacobian = evaluate(values)
    return Solution(
        values=values,
        covariance=covariance_of(jacobian, residuals, loss),
        residuals=residuals,
        jacobian=jacobian,
        cost=cost,
        converged=converged,
        message=message,
    )


def differenced(residuals: Callable[[Floats], Floats]) -> Model:
    """A model with central differences for derivatives, over a millionth of each value or of 1."""

    def model(values: Floats) -> tuple[Floats, Floats]:
        steps = 1e-6 * np.maximum(np.abs(values), 1.0)
        columns = [
            (residuals(values + step) - residuals(values - step)) / (2.0 * size)
            for step, size in zip(np.diag(steps), steps.tolist(), strict=True)
        ]
        return residuals(values), np.column_stack(columns)

    return model


def _is_stuck(result: Any) -> bool:
    """Whether the search has ended at no minimum, because the model has no value for a further step."""
    free = result.active_mask == 0
    count = int(np.count_nonzero(free))
    if not count or result.cost <= max(len(result.fun) - count, 1):
        return False
    gradient = FactoredJacobian(result.jac[:, free]).root.T @ result.grad[free]
    # the cost of a linear model would fall by half of the square
    return bool(0.5 * gradient @ gradient > _STUCK_SHARE * result.cost)


class FactoredJacobian:
    """Singular value decomposition of the derivatives J (n, k) of residuals by the coordinates of a model.

    Columns are scaled to unit length. A direction whose singular value is below `_SMALLEST_SINGULAR_VALUE` of
    the largest is not determined, and is left out of everything.

    Attributes
    ----------
    directions
        Orthonormal basis (n, m) of the residuals that the coordinates can explain.
    root
        Root (k, m) of the covariance of the coordinates, which is ``root @ root.T``.
    blind
        Whether each coordinate (k,) is not determined.
    log_det
        ln det J^T J of the directions that are determined.
    condition
        Ratio of the largest to the smallest singular value.
    """

    def __init__(self, jacobian: Floats) -> None:
        norm = np.linalg.norm(jacobian, axis=0)
        scale = np.where(norm > 0, norm, 1.0)
        directions, singular, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
        self.condition = float(singular[0] / max(singular[-1], 1e-300)) if len(singular) else 1.0
        known = singular > _SMALLEST_SINGULAR_VALUE * singular.max(initial=0.0)
        self.directions: Floats = directions[:, known]
        self.root: Floats = (vt[known].T / singular[known]) / scale[:, None]
        self.blind = 1.0 - np.sum(vt[known] ** 2, axis=0) > 1e-12
        self.log_det = 2.0 * float(np.sum(np.log(singular[known])) + np.sum(np.log(scale)))

    def residual(self, rows: Floats) -> Floats:
        """Residual of rows (n,), or of each of their columns (n, m), that the coordinates cannot explain."""
        return np.asarray(rows - self.directions @ (self.directions.T @ rows), dtype=np.float64)

    def coefficients(self, rows: Floats) -> Floats:
        """Coordinates (k,) or (k, m) whose residuals are nearest to the rows."""
        return np.asarray(self.root @ (self.directions.T @ rows), dtype=np.float64)

    def covariance(self) -> Floats:
        """Covariance (k, k) of the coordinates; infinite for those that are not determined."""
        covariance: Floats = self.root @ self.root.T
        covariance[self.blind, :] = 0.0
        covariance[:, self.blind] = 0.0
        covariance[self.blind, self.blind] = np.inf
        return covariance


def covariance_of(jacobian: Floats, residuals: Floats | None = None, loss: Loss = "linear") -> Floats:
    """Covariance (k, k) of the parameters: inverse of J^T J for the Jacobian J (n, k) of scaled residuals.

    It is infinite for parameters that are not determined. For a robust loss, which needs the `residuals`
    (n,), it is multiplied by mean(psi^2)/mean(psi')^2 of the M-estimator (Huber, Robust Statistics, 1981, eq.
    7.6.5).
    """
    if not np.all(np.isfinite(jacobian)):
        return np.diag(np.full(jacobian.shape[1], np.inf))
    covariance = FactoredJacobian(jacobian).covariance()
    if loss != "linear" and residuals is not None:
        psi, slope = _influence(residuals / _LOSS_SCALE, loss)
        psi = psi * _LOSS_SCALE
        dof = len(residuals) - jacobian.shape[1]
        covariance = covariance * (np.sum(psi**2) / dof) / np.mean(slope) ** 2
    return np.asarray(covariance, dtype=np.float64)


def _influence(z: Floats, loss: Loss) -> tuple[Floats, Floats]:
    """psi (derivative of the loss) and psi' of scipy's losses, as functions of the scaled residual."""
    if loss == "huber":
        return np.clip(z, -1, 1), (np.abs(z) <= 1).astype(np.float64)
    if loss == "soft_l1":
        return z / np.sqrt(1 + z**2), (1 + z**2) ** -1.5
    return z / (1 + z**2), (1 - z**2) / (1 + z**2) ** 2


def propagate(jacobian: Floats, covariance: Floats) -> Floats:
    """Covariance ``J C J^T`` (m, m) of quantities with the Jacobian J (m, k), for C (k, k).

    Variances may be infinite; quantities that depend on such parameters get infinite variances.
    """
    blind = ~np.isfinite(np.diag(covariance))
    finite = covariance.copy()
    finite[blind, :] = 0.0
    finite[:, blind] = 0.0
    propagated = jacobian @ finite @ jacobian.T
    lost = np.any(jacobian[:, blind] != 0, axis=1)
    propagated[lost, :] = 0.0
    propagated[:, lost] = 0.0
    propagated[lost, lost] = np.inf
    return np.asarray(propagated, dtype=np.float64)
