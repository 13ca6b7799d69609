"""How far a law is from what a decay shows, and what that leaves of its parameters.

A law that is not the pendulum's finds its parameters all the same: the residuals hold what they could not
take up, the parameters hold the rest. So the law is given room to err. Loss and duration of a half-swing and
the harmonics of the swing differ from what it says by unknown smooth functions of ln A, relative errors that
lie about zero as a Gaussian process does. How large they are is estimated by the restricted likelihood,
together with the drive of the ground: a law that lacks something otherwise calls it a drive. The values stay
as fitted; their uncertainties grow by what errors of that size do to them.

Of a true law the likeliest size is nought, or not seen, and nothing is widened.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit.exact_model import Errors, ExactModel
from processing.fit.ground import Noise
from processing.fit.law_errors import MISFIT_SEEN, Misfit
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.least_squares import propagate
from processing.swing import TurningPoints

_SPACING = 0.4
"""Of the nodes of an error, in ln A."""
_REACH = 2.0
"""Distance in ln A over which errors are alike: a wrong exponent or a term too few bends slowly."""
_GRID = 10.0 ** np.arange(-5.0, 0.51, 0.25)
"""Sizes that are tried, of losses and harmonics; those of durations are smaller by `_OF_DURATION`."""
_OF_DURATION = 1e-3
_STEPS = np.arange(0.0, -3.01, -0.25)
"""Decimal logarithms of the drives that are tried, over the one that the law without errors needs."""
_LEAST = 1e-9


class _Linear(NamedTuple):
    """Residuals, derivatives by the law's columns and by unit errors of each kind, ln det of the filter."""

    residuals: Floats
    jacobian: Floats
    errors: Sequence[Floats]
    log_det: float
    points: int


class _Sizes(NamedTuple):
    """Sizes of the errors of each kind, and -2 ln L with them and without any."""

    sizes: Floats
    deviance: float
    without: float


def misfit_of(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> Misfit:
    """How far the law of an exact fit of these points lies from them; see `with_misfit`."""
    return _misfit(points, pendulum, fit)[0]


def with_misfit(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> FitResult:
    """The fit with uncertainties that hold how far its law lies from the data.

    Raises DataError for another method than the exact one.
    """
    misfit, added = _misfit(points, pendulum, fit)
    if added is None:
        return replace(fit, misfit=misfit)
    u = fit.standard_uncertainty
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.sqrt(1.0 + np.diag(added) / u**2)
    factor = np.where(np.isfinite(factor), factor, 1.0)
    before = np.ones(len(u)) if fit.widened is None else fit.widened
    misfit = replace(misfit, widened=dict(zip(fit.names, factor.tolist(), strict=True)))
    known = np.isfinite(np.diag(fit.covariance))
    covariance = fit.covariance + np.where(np.outer(known, known), added, 0.0)
    return replace(
        fit, covariance=covariance, widened=before * factor, misfit_covariance=added, misfit=misfit,
        warnings=(*fit.warnings, *_warnings(misfit, factor)),
    )  # fmt: skip


def with_misfit_of(fit: FitResult, exact: FitResult) -> FitResult:
    """Another fit of the same law to the same points, with what the exact one found of their distance."""
    if exact.misfit_covariance is None:
        return fit
    names = [name for name in fit.names if name in exact.names]
    own, theirs = ([one.names.index(name) for name in names] for one in (fit, exact))
    added = np.zeros_like(fit.covariance)
    added[np.ix_(own, own)] = exact.misfit_covariance[np.ix_(theirs, theirs)]
    return replace(fit, covariance=fit.covariance + added, misfit_covariance=added)


def _warnings(misfit: Misfit, factor: Floats) -> tuple[str, ...]:
    parts = [
        f"its {name} by {float(f'{100 * size:.2g}'):g} %"
        for name, size in (
            ("losses", misfit.loss), ("durations", misfit.duration), ("harmonics", misfit.waveform),
        )
        if size
    ]  # fmt: skip
    text = (
        f"the law does not describe this decay (chi2 {misfit.against_law:.0f} against it): it misses "
        f"{', '.join(parts)}; uncertainties are widened for it by up to {factor.max():.2g}"
    )
    return (text,)


def _misfit(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult
) -> tuple[Misfit, Floats | None]:
    """The misfit, and the covariance of the values that it adds; None where it is not seen."""
    if fit.method is not FitMethod.EXACT or fit.ground is None:
        raise DataError("the misfit of a law is that of an exact fit")
    if fit.loss != "linear":
        return Misfit(against_law=nan), None
    model, columns = ExactModel.of(points, pendulum, fit)
    nodes = _Nodes(points.first(fit.half_cycles).amplitude / model.reference)
    waveform = model.evidence.waveform
    shapes = None if waveform is None else nodes(waveform.amplitude_rad / model.reference)
    of_waveform = by_harmonics(model, columns, shapes, nodes.count)
    own = model.noise_of(fit)
    best: _Sizes | None = None
    without = inf
    for step in _drives(own, float(np.median(model.u_amplitude))):
        here = _linear(
            model, columns, Noise(step=step, averaged=own.averaged, limit=own.limit), nodes, of_waveform
        )
        if here is None:
            continue
        found = _sized(here)
        without = min(without, found.without)
        if best is None or found.deviance < best.deviance:
            best = found
    if best is None:
        return Misfit(against_law=nan), None
    against = without - best.deviance
    if not against > MISFIT_SEEN:
        return Misfit(against_law=max(against, 0.0)), None
    sizes = best.sizes
    misfit = Misfit(
        loss=float(sizes[0]), duration=float(sizes[1]), waveform=float(sizes[2]), against_law=float(against)
    )
    # what errors of these sizes do to the values, which were found with the law's own weights
    here = _linear(model, columns, own, nodes, of_waveform)
    assert here is not None
    jacobian, errors = _weighted(here, fit.ground.measurement_scale**2)
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    by_errors = -np.linalg.lstsq(jacobian / norm, np.column_stack([*errors]), rcond=1e-10)[0] / norm[:, None]
    size = np.concatenate([np.full(part.shape[1], s) for part, s in zip(errors, sizes, strict=True)])
    of_columns = by_errors * size
    return misfit, propagate(model.columns.physical(columns)[1], of_columns @ of_columns.T)


class _Nodes:
    """Smooth functions of ln A: hats at even distances, and the root of their correlation."""

    def __init__(self, amplitude: Floats) -> None:
        x = np.log(amplitude)
        count = max(3, int(np.ceil(np.ptp(x) / _SPACING)) + 1)
        self._at = np.linspace(x.min(), x.max(), count)
        apart = np.abs(self._at[:, None] - self._at) / _REACH
        correlation = np.exp(-0.5 * apart**2) + _LEAST * np.eye(count)
        self._root = np.linalg.cholesky(correlation)
        self.count = count

    def __call__(self, amplitude: Floats, _: Floats | None = None) -> Floats:
        """Values (n, m) of m independent unit errors."""
        x = np.clip(np.log(amplitude), self._at[0], self._at[-1])
        width = self._at[1] - self._at[0]
        hats = np.maximum(0.0, 1.0 - np.abs(x[:, None] - self._at) / width)
        return np.asarray(hats @ self._root)


def _drives(own: Noise, unit: float) -> list[float]:
    """Steps of the drive that are tried, with none."""
    largest = own.step if own.step > 0 else 1e-3 * unit
    return [*(largest * 10.0**_STEPS).tolist(), 0.0]


def by_harmonics(model: ExactModel, columns: Floats, shapes: Floats | None, count: int) -> Floats:
    """Derivatives of the residuals of the evidence by relative errors of the law's harmonics.

    `shapes` (pieces, count) are those errors for the pieces of the waveform; None where there is none.
    """
    evidence, pendulum = model.evidence, model.pendulum
    out = np.zeros((len(model.beside(columns)[0]), count))
    if evidence.waveform is None or pendulum is None or shapes is None:
        return out
    waveform = evidence.waveform
    physical, _ = model.columns.physical(columns)
    values = dict(zip(model.names, physical.tolist(), strict=True))
    predicted = waveform.predicted_rad(model.law, values, pendulum)
    for column, shape in enumerate(shapes.T):
        moved = waveform.reduced(shape[:, None] * predicted)
        out[: len(moved), column] = moved
    return out


def _linear(
    model: ExactModel, columns: Floats, noise: Noise, nodes: _Nodes, of_waveform: Floats
) -> _Linear | None:
    """Everything near the columns for one drive; None where the filter has no value."""
    found = model.filtered(columns, noise, errors=Errors(nodes, nodes))
    if not np.all(np.isfinite(found.residuals)):
        return None
    beside, beside_by = model.beside(columns)
    law, m = len(columns), of_waveform.shape[1]
    count = len(found.residuals)
    padded = [
        np.concatenate([part, np.zeros((len(beside), m))])
        for part in (found.jacobian[:, law : law + m], found.jacobian[:, law + m :])
    ]
    return _Linear(
        np.concatenate([found.residuals, beside]),
        np.concatenate([found.jacobian[:, :law], beside_by]),
        [*padded, np.concatenate([np.zeros((count, m)), of_waveform])],
        found.log_det,
        count,
    )


def _weighted(here: _Linear, scale2: float) -> tuple[Floats, list[Floats]]:
    """Derivatives over the standard deviation of turning points that scatter by the root of `scale2`."""
    weight = np.ones(len(here.residuals))
    weight[: here.points] = scale2**-0.5
    return here.jacobian * weight[:, None], [part * weight[:, None] for part in here.errors]


def _sized(here: _Linear) -> _Sizes:
    """The likeliest sizes of the errors for one drive."""
    scale2 = 1.0
    for _ in range(3):
        found, left = _at_scale(here, scale2)
        before, scale2 = scale2, max(1.0, left)
        if abs(scale2 - before) < 0.01 * scale2:
            break
    # without errors the scatter may be larger instead
    plain = 1.0
    for _ in range(3):
        deviance, left = _without(here, plain)
        before, plain = plain, max(1.0, left)
        if abs(plain - before) < 0.001 * plain:
            break
    return found._replace(without=deviance)


def _prepared(here: _Linear, scale2: float) -> tuple[Floats, Floats, Floats, float]:
    """Directions of the law, residuals, weights of the rows and the constant part of -2 ln L."""
    weight = np.ones(len(here.residuals))
    weight[: here.points] = scale2**-0.5
    jacobian = here.jacobian * weight[:, None]
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    directions, spread, _ = np.linalg.svd(jacobian / norm, full_matrices=False)
    kept = spread > 1e-9 * spread[0]
    constant = here.points * np.log(scale2) + here.log_det
    constant += 2 * float(np.sum(np.log(spread[kept]))) + 2 * float(np.sum(np.log(norm)))
    return directions[:, kept], here.residuals * weight, weight, constant


def _without(here: _Linear, scale2: float) -> tuple[float, float]:
    directions, residuals, _, constant = _prepared(here, scale2)
    left = residuals - directions @ (directions.T @ residuals)
    chi2 = float(np.sum(left[: here.points] ** 2)) * scale2
    return constant + float(left @ left), chi2 / (here.points - directions.shape[1])


def _at_scale(here: _Linear, scale2: float) -> tuple[_Sizes, float]:
    directions, residuals, weight, constant = _prepared(here, scale2)
    parts = np.column_stack(here.errors) * weight[:, None]
    parts -= directions @ (directions.T @ parts)
    left = residuals - directions @ (directions.T @ residuals)
    gram, score, chi2 = parts.T @ parts, parts.T @ left, float(left @ left)
    kinds = np.repeat(np.arange(len(here.errors)), [part.shape[1] for part in here.errors])
    grids = [_GRID, _OF_DURATION * _GRID, _GRID]

    def deviance(sizes: Floats) -> float:
        size = sizes[kinds]
        inner = np.eye(len(size)) + gram * np.outer(size, size)
        scaled = score * size
        root = np.linalg.cholesky(inner)
        half = np.linalg.solve(root, scaled)
        return constant + chi2 - float(half @ half) + 2 * float(np.sum(np.log(np.diag(root))))

    sizes = np.zeros(len(grids))
    lowest = deviance(sizes)
    tried: list[Floats] = []
    for _ in range(2):
        tried = []
        for kind, grid in enumerate(grids):
            found = []
            for size in [0.0, *grid.tolist()]:
                sizes[kind] = size
                found.append(deviance(sizes))
            at = int(np.argmin(found))
            sizes[kind] = 0.0 if at == 0 else grid[at - 1]
            lowest = found[at]
            tried.append(np.array(found[1:]))
    # the mean square over what the data allow: of few nodes the likeliest size is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (tried[kind] - tried[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    size = sizes[kinds]
    inner = np.eye(len(size)) + gram * np.outer(size, size)
    fitted = parts @ (size * np.linalg.solve(inner, score * size))
    rest = (left - fitted)[: here.points]
    scatter = float(rest @ rest) * scale2 / (here.points - directions.shape[1])
    return _Sizes(averaged, lowest, inf), scatter
