"""Measurement of the air's drag from runs of one contact with different vanes on the pendulum.

They add to its drag: ``drag = d0 + k area``. The contact is the same in all runs, the period is not: vanes
have inertia. All runs are fitted together, each with the noise and the waveform of its own fit, and
with its own period, first amplitude and time. Contact and drag of a single run may lie far along a curved
valley; what they share is where the valleys meet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import AMPLITUDE, DRAG, PAPER, TIME
from processing.errors import DataError
from processing.estimate import Estimate, FitMethod
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.fit.terms import Term
from processing.fit.terms import solve as solve_terms
from processing.least_squares import FactoredJacobian, covariance_of, differenced, solve
from processing.swing import TurningPoints

_OWN = ("period0_s", AMPLITUDE.key, TIME.key)
_COMMON = tuple(name for name in PAPER.names() if name not in _OWN)
_AIR = len(_COMMON)
"""Place of d0 among the shared parameters; k follows."""
_DISAGREEMENT_CHANCE = 0.01
"""Chance of the runs' scatter below which they do not share a contact and a line."""


@dataclass(frozen=True, slots=True)
class VanedRun:
    """A run with its exact fit, and the area of its vanes.

    Points and fit are those of the second measurement (`refinement`). As detected, the first twenty
    half-cycles share an error of time, which no uncertainty of a turning point states: even on ground at rest
    n, gamma and the period would scatter 1.2 to 1.5 times as much as stated.
    """

    points: TurningPoints
    fit: FitResult
    area_m2: float


@dataclass(frozen=True, slots=True)
class MeasuredAir:
    """The drag without vanes, from runs with several areas.

    Attributes
    ----------
    drag_s, per_m2_s
        d0, and k.
    contact
        The contact's parameters from all runs together.
    of_runs_s, off_s
        The drag of each run with the contact of all, and that minus the line.
    chi2, dof, chance
        Rise of chi2 by one contact and one line over separate fits of the runs, its degrees of freedom and
        its probability.
    enlarged
        Factor by which the uncertainties are larger for that rise: the root of chi2/dof, at least 1, however
        probable it is. Each run estimates the drive of the ground by itself, and a weak drive only to a
        factor of two; u(k), u(n) and u(gamma) grow in proportion to it. The rise is what all runs together
        say of it. Over 42 sets of runs on weak ground the root mean square error is with it 0.9 u of d0 and
        1.05 u of k, but still 1.4 u of n and gamma.
    """

    drag_s: Estimate
    per_m2_s: Estimate
    contact: Mapping[str, Estimate]
    of_runs_s: tuple[Estimate, ...]
    off_s: tuple[float, ...]
    chi2: float
    dof: int
    chance: float
    enlarged: float

    @property
    def disagree(self) -> bool:
        """Whether the runs do not share one contact and one line."""
        return self.chance < _DISAGREEMENT_CHANCE


class _RunModel(NamedTuple):
    """A run, its model with its noise, the columns of its own fit, and the scale of its residuals."""

    stated: VanedRun
    model: ExactModel
    columns: Floats
    size: float


class _SharedParameters:
    """The parameters of all runs in the solver's units, in which each is of the order of 1.

    First those of the contact (`_COMMON`, ln b and gamma at the reference amplitude), d0 and k; then for each
    run T0, first amplitude and first time.
    """

    def __init__(self, runs: Sequence[_RunModel]) -> None:
        self.runs, self.count = runs, _AIR + 2
        fits = [run.stated.fit for run in runs]
        self.log_r = float(np.mean([np.log(fit.reference_rad) for fit in fits]))
        start = [np.median([self._at_reference(fit)[k] for fit in fits]) for k in range(_AIR)]
        lines = np.array([self.line(run.stated.area_m2) for run in runs])
        drags = np.array([fit.estimate(DRAG.key).value for fit in fits])
        start += FactoredJacobian(lines).coefficients(drags).tolist()
        self.unit = np.abs(np.array(start))
        self.unit[self.unit == 0] = 1.0
        self.own = [np.array([tuple(fit.estimate(name)) for name in _OWN]).T for fit in fits]
        self.start = np.concatenate([np.array(start) / self.unit, np.zeros(len(_OWN) * len(runs))])

    def _at_reference(self, fit: FitResult) -> list[float]:
        known = fit.named_values
        known["b"] = float(np.log(known["b"]) + (known["p"] - 1) * self.log_r)
        known["gamma_pa"] *= float(np.exp(known["n"] * self.log_r))
        return [known[name] for name in _COMMON]

    def physical(self, shared: Floats) -> Floats:
        """SI values of the contact, then d0 and k."""
        values = shared * self.unit
        known = dict(zip(_COMMON, values[:_AIR].tolist(), strict=True))
        known["b"] = float(np.exp(known["b"] + (1 - known["p"]) * self.log_r))
        known["gamma_pa"] *= float(np.exp(-known["n"] * self.log_r))
        return np.array([*(known[name] for name in _COMMON), *values[_AIR:]])

    @staticmethod
    def line(area_m2: float) -> Floats:
        """Derivatives of the drag with respect to d0 and k at an area."""
        return np.array([1.0, area_m2])

    def __call__(self, values: Floats) -> tuple[Floats, Floats]:
        """Residuals of all runs, and their derivatives."""
        residuals, by, _ = zip(*(self.of_run(values, k) for k in range(len(self.runs))), strict=True)
        return np.concatenate(residuals), np.concatenate(by)

    def own_columns(self, number: int) -> slice:
        """Places of the parameters of one run alone."""
        first = self.count + len(_OWN) * number
        return slice(first, first + len(_OWN))

    def of_run(self, values: Floats, number: int) -> tuple[Floats, Floats, Floats]:
        """Residuals of one run, their derivatives, and those with respect to its own drag."""
        run, own = self.runs[number], self.own_columns(number)
        shared, by_shared = differenced(self.physical)(values[: self.count])
        line = self.line(run.stated.area_m2)
        centre, size = self.own[number]
        known = dict(zip(_COMMON, shared[:_AIR].tolist(), strict=True))
        known[DRAG.key] = float(line @ shared[_AIR:])
        known |= dict(zip(_OWN, (centre + size * values[own]).tolist(), strict=True))
        columns = run.model.columns.from_physical(known)
        residuals, jacobian = run.model.linearised_at(columns)(columns)
        by_physical = jacobian @ np.linalg.inv(run.model.columns.physical(columns)[1])
        common, private = (by_physical[:, self._places(run, names)] for names in (_COMMON, _OWN))
        by_drag = by_physical[:, self._places(run, (DRAG.key,))]
        by = np.zeros((len(residuals), len(values)))
        by[:, : self.count] = np.column_stack([common, by_drag * line]) @ by_shared
        by[:, own] = private * size
        return residuals / run.size, by / run.size, by_drag[:, 0] / run.size

    @staticmethod
    def _places(run: _RunModel, names: Sequence[str]) -> list[int]:
        return [run.model.names.index(name) for name in names]


def air_of_vanes(runs: Sequence[VanedRun], pendulum: PendulumOnBall) -> MeasuredAir:
    """The drag of the pendulum itself, from runs with different vanes.

    Raises
    ------
    DataError
        Fewer than two areas, a fit that is not exact, has no drag or a prior of it, or no convergence.
    """
    from scipy.special import chdtrc

    _check(runs)
    models = [_run_model(run, pendulum) for run in runs]
    shared = _SharedParameters(models)
    free = np.full(len(shared.start), np.inf)
    model = partial(_finite_or_nan, shared)
    found = solve(model, shared.start, lower=-free, upper=free, cost_tolerance=1e-9)
    if not found.converged:
        raise DataError("no fit with one contact common to all runs converges; check which run differs")
    alone = sum(float(np.sum((run.model(run.columns)[0] / run.size) ** 2)) for run in models)
    chi2 = max(0.0, 2 * found.cost - alone)
    dof = len(runs) * (_AIR + 1) - shared.count
    chance = float(chdtrc(dof, chi2))
    enlarged = max(1.0, float(np.sqrt(chi2 / dof)))
    covariance = covariance_of(found.jacobian) * enlarged**2
    values, by = differenced(shared.physical)(found.values[: shared.count])
    u = np.sqrt(np.diag(by @ covariance[: shared.count, : shared.count] @ by.T))
    estimates = [Estimate(*one) for one in zip(values.tolist(), u.tolist(), strict=True)]
    drags = [_drag_of(shared, found.values, number) for number in range(len(runs))]
    return MeasuredAir(
        drag_s=estimates[_AIR],
        per_m2_s=estimates[-1],
        contact=dict(zip(_COMMON, estimates[:_AIR], strict=True)),
        of_runs_s=tuple(drag for drag, _ in drags),
        off_s=tuple(off for _, off in drags),
        chi2=chi2,
        dof=dof,
        chance=chance,
        enlarged=enlarged,
    )


def _check(runs: Sequence[VanedRun]) -> None:
    if len({run.area_m2 for run in runs}) < 2:
        raise DataError("the drag is measured at two areas of vanes at least; make runs at three")
    for number, run in enumerate(runs, 1):
        if run.fit.method is not FitMethod.EXACT or not run.fit.has_drag:
            raise DataError(f"run {number} was fitted without a drag")
        if run.fit.evidence.drag_s is not None:
            raise DataError(
                f"run {number} was fitted with prior knowledge of the air and so measures no drag"
            )
        if not np.all(np.isfinite(np.diag(run.fit.covariance))):
            raise DataError(f"run {number} does not determine contact and drag; start higher, or shield it")


def _run_model(run: VanedRun, pendulum: PendulumOnBall) -> _RunModel:
    """The model of a run, its residuals scaled so that the drag has the uncertainty of the run's own fit."""
    model, columns = ExactModel.of(run.points, pendulum, run.fit)
    size = max(1.0, run.fit.chi2_per_dof) ** 0.5
    if run.fit.u_inflation is not None:
        size *= float(run.fit.u_inflation[run.fit.names.index(DRAG.key)])
    return _RunModel(run, model, columns, size)


def _finite_or_nan(shared: _SharedParameters, values: Floats) -> tuple[Floats, Floats]:
    """Those of `_SharedParameters`, with NaN residuals and no error for a trial where no pendulum swings."""
    try:
        return shared(values)
    except (DataError, np.linalg.LinAlgError):
        residuals, jacobian = shared(shared.start)
        return np.full_like(residuals, np.nan), jacobian


def _drag_of(shared: _SharedParameters, values: Floats, number: int) -> tuple[Estimate, float]:
    """The drag of one run with the contact of all, and how far it is off the line, by one linear step."""
    residuals, by, by_drag = shared.of_run(values, number)
    air = shared.physical(values[: shared.count])[_AIR:]
    on_line = float(shared.line(shared.runs[number].stated.area_m2) @ air)
    found = solve_terms(residuals, by[:, shared.own_columns(number)], [Term("drag", by_drag)])
    off = float(found.values[0])
    return Estimate(on_line + off, float(np.sqrt(found.covariance[0, 0]))), off
