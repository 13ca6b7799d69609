"""Terms in addition to a law: all effects that move the residuals of a fit linearly, estimated in one way.

A fit that has ended is linear near its end: ``r + J d + E z`` for changes d of the law's coordinates and the
coordinates z of terms, each with its prior about zero. Rows are in units of their scatter, everywhere.
`solve` is the generalised least squares of that; `RestrictedLikelihood` is the restricted likelihood of the
sizes of groups of coordinates.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import log, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import FitMethod
from processing.fit.exact_model import DiscrepancyColumns, ExactModel
from processing.fit.ground import Noise
from processing.fit.result import FitResult
from processing.least_squares import FactoredJacobian
from processing.swing import TurningPoints


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One or more coordinates that move the residuals of a fit in addition to the law's."""

    name: str
    """Name of the term's line in the budget."""
    columns: Floats = field(repr=False)
    """Derivatives (rows, m) of the residuals by the coordinates."""
    prior: float | Floats = np.inf
    """Prior standard uncertainty of each coordinate about zero; infinite where nothing is known."""
    report: str = "move"
    """Use by a result: its values `move` to those with the term, or they stay and their uncertainties `cover`
    the term."""


class TermSolution(NamedTuple):
    """Coordinates of terms, in the order in which they were given, and their effect on the law's."""

    values: Floats
    """Coordinates (m,)."""
    covariance: Floats
    """Their covariance (m, m); infinite where neither data nor a prior determine one."""
    root: Floats
    """Root (m, k) of the covariance."""
    law_shift: Floats
    """Change (n,) of the law's coordinates by the terms."""
    law_by_terms: Floats
    """Derivatives (n, m) of the fitted law's coordinates by those of the terms."""
    residuals: Floats
    """Residuals that neither law nor terms explain."""

    def scatter(self, dof: int) -> float:
        """Standard deviation of the residuals, at least the stated one, 1."""
        return sqrt(max(1.0, float(self.residuals @ self.residuals) / dof))


def solve(residuals: Floats, jacobian: Floats, terms: Sequence[Term]) -> TermSolution:
    """Terms and law together, by generalised least squares near the end of a fit.

    Rows with a value that is not finite are left out. ``z = -(E^T P E + prior^-2)^-1 E^T P r``, where P
    projects out the directions of the law's coordinates.
    """
    columns = np.column_stack([term.columns for term in terms])
    prior = np.concatenate([np.broadcast_to(term.prior, _width(term.columns)) for term in terms])
    good = np.isfinite(residuals) & np.isfinite(jacobian).all(axis=1) & np.isfinite(columns).all(axis=1)
    residuals, columns = residuals[good], columns[good]
    law = FactoredJacobian(jacobian[good])
    unexplained_columns, unexplained = law.residual(columns), law.residual(residuals)
    # a prior of zero keeps a coordinate where it is
    free = prior > 0
    augmented = FactoredJacobian(np.concatenate([unexplained_columns[:, free], np.diag(1.0 / prior[free])]))
    values, covariance = np.zeros(len(prior)), np.zeros((len(prior), len(prior)))
    values[free] = -augmented.coefficients(np.concatenate([unexplained, np.zeros(int(free.sum()))]))
    covariance[np.ix_(free, free)] = augmented.covariance()
    root = np.zeros((len(prior), augmented.root.shape[1]))
    root[free] = augmented.root
    law_by_terms = law.coefficients(columns)
    law_shift = -law.coefficients(residuals) - law_by_terms @ values
    remaining = unexplained + unexplained_columns @ values
    return TermSolution(values, covariance, root, law_shift, law_by_terms, remaining)


def _width(columns: Floats) -> int:
    return 1 if columns.ndim == 1 else columns.shape[1]


class RestrictedLikelihood:
    """Restricted likelihood of the sizes of groups of independent coordinates in addition to a law.

    Parameters
    ----------
    residuals, jacobian
        Residuals of the law in units of their scatter, and their derivatives with respect to its coordinates.
    groups
        Derivatives (rows, m) of the residuals by the coordinates of each group, for the size 1.
    """

    def __init__(self, residuals: Floats, jacobian: Floats, groups: Sequence[Floats] = ()) -> None:
        self.law = FactoredJacobian(jacobian)
        self._left = self.law.residual(residuals)
        self._groups = np.repeat(np.arange(len(groups)), [group.shape[1] for group in groups])
        columns = np.column_stack(groups) if len(groups) else np.zeros((len(residuals), 0))
        self._projected = self.law.residual(columns)
        self._gram, self._score = self._projected.T @ self._projected, self._projected.T @ self._left
        self._of_law = self.law.log_det + float(self._left @ self._left)

    def deviance(self, sizes: Floats) -> float:
        """-2 ln L with groups of these sizes, up to a part of the rows' weights alone."""
        return float(self.deviances(sizes, 0, sizes[:1])[0]) if len(sizes) else self._of_law

    def deviances(self, sizes: Floats, group: int, tried: Floats) -> Floats:
        """-2 ln L for every size `tried` of one group, with the other groups at their `sizes`."""
        own = self._groups == group
        size = sizes[self._groups[~own]]
        # without the other groups' part, this group's matrix is diagonal in its own directions
        inner = np.eye(len(size)) + self._gram[np.ix_(~own, ~own)] * np.outer(size, size)
        root = np.linalg.cholesky(inner)
        mixed = np.column_stack([self._gram[np.ix_(~own, own)], self._score[~own]]) * size[:, None]
        whitened = np.linalg.solve(root, mixed)
        coupling, other_score = whitened[:, :-1], whitened[:, -1]
        power, directions = np.linalg.eigh(self._gram[np.ix_(own, own)] - coupling.T @ coupling)
        score = directions.T @ (self._score[own] - coupling.T @ other_score)
        inflation = 1.0 + np.outer(tried**2, np.maximum(power, 0.0))
        of_others = 2.0 * float(np.sum(np.log(np.diag(root)))) - float(other_score @ other_score)
        of_group = np.sum(np.log(inflation) - (tried[:, None] * score) ** 2 / inflation, axis=1)
        return np.asarray(self._of_law + of_others + of_group)

    def unexplained(self, sizes: Floats) -> Floats:
        """Residuals that neither law nor groups of these sizes explain."""
        size = sizes[self._groups]
        inner = np.eye(len(size)) + self._gram * np.outer(size, size)
        return np.asarray(self._left - self._projected @ (size * np.linalg.solve(inner, self._score * size)))


class DrivenRows(NamedTuple):
    """Residuals of a fit for some drive of the ground: those of turning points, then those of evidence."""

    residuals: Floats
    """(rows,); NaN where the filter has no value."""
    jacobian: Floats
    """(rows, n) by the law's coordinates."""
    by_errors: Floats
    """(rows, m) by errors of the law."""
    log_det: float
    """ln det of the covariance of the rows of the turning points."""
    points: int
    """Number of rows of turning points."""

    @classmethod
    def of(
        cls,
        model: ExactModel,
        coordinates: Floats,
        noise: Noise,
        errors: DiscrepancyColumns | None = None,
        of_waveform: Floats | None = None,
    ) -> "DrivenRows":
        """The rows of a model for a drive, with their derivatives with respect to errors of the law.

        `of_waveform` (evidence rows, errors) are those of the evidence; 0 by default.
        """
        filtered = model.filtered(coordinates, noise, errors=errors)
        evidence, by_law = model.evidence_rows(coordinates)
        law, points = len(coordinates), len(filtered.residuals)
        of_points = filtered.jacobian[:, law:]
        if of_waveform is None:
            of_waveform = np.zeros((len(evidence), of_points.shape[1]))
        # errors of the waveform alone move no turning point
        of_points = np.pad(of_points, ((0, 0), (0, of_waveform.shape[1] - of_points.shape[1])))
        return cls(
            np.concatenate([filtered.residuals, evidence]),
            np.concatenate([filtered.jacobian[:, :law], by_law]),
            np.concatenate([of_points, of_waveform]),
            filtered.log_det,
            points,
        )

    def in_scatter(self, scale: float) -> "DrivenRows":
        """The rows in units of their scatter where turning points scatter `scale` times as much as stated."""
        weight = np.ones((len(self.residuals), 1))
        weight[: self.points] = 1.0 / scale
        return DrivenRows(
            self.residuals * weight[:, 0],
            self.jacobian * weight,
            self.by_errors * weight,
            self.log_det + 2 * self.points * log(scale),
            self.points,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedFit:
    """An exact fit that has ended: its residuals in units of their scatter, and their derivatives."""

    fit: FitResult
    model: ExactModel
    """The model with the fit's noise."""
    coordinates: Floats
    """The solver's coordinates at which the fit ended."""
    scale: float
    """The factor by which the turning points scatter more than stated."""
    residuals: Floats
    """Of turning points, then of the evidence (rows,)."""
    jacobian: Floats
    to_physical: Floats
    """Derivatives of the fit's values with respect to the coordinates."""

    @classmethod
    def of(cls, points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> "LinearisedFit":
        """The linearised fit of these points; raises DataError for another method than the exact one."""
        if fit.method is not FitMethod.EXACT:
            raise DataError(f"terms are added to an exact fit, and this one is {fit.method}")
        model, coordinates = ExactModel.of(points, pendulum, fit)
        residuals, jacobian = model(coordinates)
        scale, to_physical = model.scale, model.parametrisation.physical(coordinates)[1]
        return cls(fit, model, coordinates, scale, residuals / scale, jacobian / scale, to_physical)

    @property
    def points(self) -> TurningPoints:
        return self.model.points

    @property
    def noise(self) -> Noise:
        """The noise by which the fit weighted its residuals."""
        return self.model.noise_of(self.fit)

    def noises(self, drive_factors: Iterable[float]) -> list[Noise]:
        """The noise with multiples of the likeliest drive; where that is 0, of a small one."""
        own = self.noise
        largest = own.step if own.step > 0 else 1e-3 * float(np.median(self.model.u_amplitude))
        return [replace(own, step=largest * factor) for factor in drive_factors]

    def residual_changes(self, amplitude: Floats | float = 0.0, time_s: Floats | float = 0.0) -> Floats:
        """Changes (rows, m) of the residuals where measured values are larger by errors (points, m)."""
        model, changes = self.model, []
        errors = np.broadcast_arrays(np.divide(amplitude, self.model.reference), time_s)
        for amplitude_error, time_error in zip(*(error.T for error in errors), strict=True):
            # a small step, since a filter with a limit is linear only near its values
            errors_u = amplitude_error / model.u_amplitude, time_error / self.points.u_time_s
            largest_u = float(np.max(np.abs(errors_u)))
            step = _DERIVATIVE_STEP_U / max(largest_u, 1e-300)
            larger = model.with_larger_measurements(step * amplitude_error, step * time_error)
            changes.append((larger(self.coordinates)[0] / self.scale - self.residuals) / step)
        return np.asarray(changes, dtype=np.float64).T

    def loss_derivatives(self, loss: Callable[[Floats], Floats], waveform: dict[str, float]) -> Floats:
        """Derivatives (rows,) of the residuals by the size of a further loss, a function of the amplitude.

        `waveform` is added to the law's values for the waveform that belongs to a size of 1.
        """
        model, coordinates = self.model, self.coordinates
        _, law_loss = model.losses(coordinates)
        further = DiscrepancyColumns(
            lambda a, _: (loss(a) / law_loss)[:, None], lambda a, _: np.zeros((len(a), 0))
        )
        of_waveform = model.evidence_residuals(coordinates, waveform) - model.evidence_residuals(coordinates)
        rows = DrivenRows.of(model, coordinates, self.noise, further, of_waveform[:, None])
        return rows.in_scatter(self.scale).by_errors[:, 0]

    def value_changes(self, columns: Floats) -> Floats:
        """Changes (values, m) of the fit's values where residuals are larger by (rows, m)."""
        good = np.isfinite(self.jacobian).all(axis=1) & np.isfinite(columns).all(axis=1)
        return -self.to_physical @ FactoredJacobian(self.jacobian[good]).coefficients(columns[good])

    def parameter_changes(self, columns: Floats) -> Floats:
        """The same of the contact parameters alone."""
        places = [self.fit.names.index(name) for name in self.fit.contact_names]
        return self.value_changes(columns)[places]

    def solve_terms(self, *terms: Term) -> TermSolution:
        """The terms and the law together, near the end of the fit."""
        return solve(self.residuals, self.jacobian, terms)

    def with_terms(self, *terms: Term) -> FitResult:
        """The fit with terms, each a line in `FitResult.terms` and in the budget.

        Terms that `move` the values are solved together, and so are those that `cover` their effect. An
        effect that two of them share counts with the first. Raises DataError for a term that neither the data
        nor a prior determine.
        """
        fit = self.fit
        for report in ("move", "cover"):
            chosen = [term for term in terms if term.report == report]
            if not chosen:
                continue
            solution = self.solve_terms(*chosen)
            names = [term.name for term in chosen for _ in range(_width(term.columns))]
            for name, variance in zip(names, np.diag(solution.covariance).tolist(), strict=True):
                if not variance < np.inf:
                    raise DataError(f"the data do not determine {name}: state what is known of it")
            if report == "move":
                shifted = self.coordinates + solution.law_shift
                fit = replace(fit, values=self.model.parametrisation.physical(shifted)[0])
            # a triangular root: its columns are those of the coordinates in their order
            root = np.linalg.qr(solution.root.T)[1].T
            changes = self.to_physical @ solution.law_by_terms @ root
            for term in chosen:
                own = [column for column, name in enumerate(names[: changes.shape[1]]) if name == term.name]
                fit = fit.with_term(term.name, changes[:, own])
        return fit


_DERIVATIVE_STEP_U = 0.1
"""Step of a derivative with respect to measured values, in their uncertainties."""
