"""Departures of a decay from its law: smooth errors of the law, and changes during the run with their times.

A change is sought at every half-cycle: a step of the friction, a step of the period. Each is judged by the
restricted likelihood, with the drive of the ground estimated anew, and counts where no smooth error of the
law explains the decay as well. Knocks are found by the fit itself, which begins anew after each (`knocks`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import inf, log, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.fit.effects import loss_shares
from processing.fit.exact_model import DiscrepancyColumns
from processing.fit.ground import Noise
from processing.fit.result import (
    CLEAR_CHANGE_GAIN,
    DISCREPANCY,
    DISCREPANCY_SEEN,
    FRICTION_STEP,
    Change,
    ChangeKind,
    DiscrepancySize,
    FitResult,
)
from processing.fit.terms import DrivenRows, LinearisedFit, RestrictedLikelihood
from processing.least_squares import FactoredJacobian
from processing.noise_models import robust_scatter

_MAX_NODE_SPACING = 0.4
"""Largest distance of an error's nodes, in ln A."""
_CORRELATION_LENGTH = 2.0
"""Distance in ln A over which errors are correlated: a wrong exponent or a missing term bends slowly."""
_SIZES_TRIED = 10.0 ** np.arange(-5.0, 0.51, 0.25)
"""Relative errors of losses and harmonics that are tried; those of durations are smaller by
`_DURATION_SHARE`."""
_DURATION_SHARE = 1e-3
_ERROR_DRIVE_FACTORS = (*10.0 ** np.arange(0.0, -3.01, -0.25), 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without errors."""
_DIAGONAL_EXCESS = 1e-9
"""Added to the diagonal of a correlation matrix, so that rounding leaves it a root."""


class _Sizes(NamedTuple):
    """Sizes (3,) of the errors of losses, durations and harmonics."""

    likeliest: Floats
    averaged: Floats
    """Rms over the sizes that the data allow."""
    deviance: float
    """-2 ln L of the likeliest sizes."""


def with_discrepancy(linearised: LinearisedFit, fit: FitResult | None = None) -> FitResult:
    """The fit with uncertainties that contain its law's discrepancy from the data.

    `fit` is the fit that receives the term, where it has terms that `linearised.fit` has not.
    """
    fit = linearised.fit if fit is None else fit
    discrepancy, changes = _discrepancy(linearised)
    if changes is None:
        return replace(fit, discrepancy=discrepancy)
    wider = fit.with_term(DISCREPANCY, changes)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(wider.standard_uncertainty / fit.standard_uncertainty, nan=1.0)
    discrepancy = replace(discrepancy, u_inflation=dict(zip(fit.names, factor.tolist(), strict=True)))
    return replace(wider, discrepancy=discrepancy, warnings=(*fit.warnings, _warning(discrepancy, factor)))


def _warning(discrepancy: DiscrepancySize, factor: Floats) -> str:
    errors = [
        f"its {name} by {float(f'{100 * size:.2g}'):g} %"
        for name, size in (
            ("losses", discrepancy.loss),
            ("durations", discrepancy.duration),
            ("harmonics", discrepancy.waveform),
        )
        if size
    ]
    return (
        f"the law does not describe this decay (chi2 {discrepancy.against_law:.0f} against it): it misses "
        f"{', '.join(errors)}; uncertainties are widened for it by up to {factor.max():.2g}"
    )


def _discrepancy(linearised: LinearisedFit) -> tuple[DiscrepancySize, Floats | None]:
    """The discrepancy, and changes of the values by errors of its size; None where it is not seen."""
    if linearised.fit.loss != "linear":
        return DiscrepancySize(against_law=nan), None
    model = linearised.model
    nodes = _HatFunctions(linearised.points.amplitude / model.reference)
    of_waveform = _by_harmonics(linearised, nodes)
    errors = DiscrepancyColumns(nodes, nodes)

    def driven(noise: Noise) -> DrivenRows:
        return DrivenRows.of(model, linearised.coordinates, noise, errors, of_waveform)

    all_rows = map(driven, _with_drives(linearised, _ERROR_DRIVE_FACTORS))
    trials = [rows for rows in all_rows if np.all(np.isfinite(rows.residuals))]
    if not trials:
        return DiscrepancySize(against_law=nan), None
    best = min((_scaled(rows, _likeliest_sizes, 0.01) for rows in trials), key=lambda sizes: sizes.deviance)
    # without errors the scatter may be larger instead
    against = min(_scaled(rows, _without_errors, 0.001).deviance for rows in trials) - best.deviance
    if not against > DISCREPANCY_SEEN:
        return DiscrepancySize(against_law=max(against, 0.0)), None
    loss, duration, waveform = best.averaged.tolist()
    discrepancy = DiscrepancySize(loss=loss, duration=duration, waveform=waveform, against_law=float(against))
    # the effect of errors of these sizes on the values, which were fitted with the law's own weights
    rows = driven(linearised.noise).in_scatter(linearised.scale)
    law, sizes = FactoredJacobian(rows.jacobian), np.repeat(best.averaged, nodes.count)
    return discrepancy, linearised.to_physical @ law.coefficients(rows.by_errors * sizes)


class _HatFunctions:
    """Smooth functions of ln A: linear interpolation between even nodes, with correlated values at them."""

    def __init__(self, amplitude: Floats) -> None:
        x = np.log(amplitude)
        count = max(3, int(np.ceil(np.ptp(x) / _MAX_NODE_SPACING)) + 1)
        self._nodes = np.linspace(x.min(), x.max(), count)
        distance = np.abs(self._nodes[:, None] - self._nodes) / _CORRELATION_LENGTH
        correlation = np.exp(-0.5 * distance**2) + _DIAGONAL_EXCESS * np.eye(count)
        self._root = np.linalg.cholesky(correlation)
        self.count = count

    def __call__(self, amplitude: Floats, _: Floats | None = None) -> Floats:
        """Values (n, m) of m independent unit errors."""
        x = np.clip(np.log(amplitude), self._nodes[0], self._nodes[-1])
        width = self._nodes[1] - self._nodes[0]
        hats = np.maximum(0.0, 1.0 - np.abs(x[:, None] - self._nodes) / width)
        return np.asarray(hats @ self._root)


def _with_drives(linearised: LinearisedFit, factors: Iterable[float]) -> list[Noise]:
    """The fit's noise with multiples of the likeliest drive; where that is 0, of a small one."""
    own = linearised.noise
    largest = own.step if own.step > 0 else 1e-3 * float(np.median(linearised.model.u_amplitude))
    return [replace(own, step=largest * factor) for factor in factors]


def _by_harmonics(linearised: LinearisedFit, nodes: _HatFunctions) -> Floats:
    """The evidence's derivatives with respect to relative errors of losses, durations (0) and harmonics."""
    model, waveform = linearised.model, linearised.model.evidence.waveform
    derivatives = np.zeros((len(model.evidence_residuals(linearised.coordinates)), 3 * nodes.count))
    if waveform is None:
        return derivatives
    predicted = waveform.predicted_rad(model.law, model.values(linearised.coordinates), model.pendulum)
    for column, shape in enumerate(nodes(waveform.amplitude_rad / model.reference).T, 2 * nodes.count):
        reduced = waveform.reduced(shape[:, None] * predicted)
        derivatives[: len(reduced), column] = reduced
    return derivatives


def _scaled(
    stated: DrivenRows, estimate: Callable[[RestrictedLikelihood], _Sizes], tolerance: float
) -> _Sizes:
    """Sizes by `estimate`, for turning points that scatter as much as their residuals with these sizes do."""
    scale2 = 1.0
    for _ in range(3):
        rows = stated.in_scatter(sqrt(scale2))
        restricted = RestrictedLikelihood(rows.residuals, rows.jacobian, np.split(rows.by_errors, 3, axis=1))
        sizes = estimate(restricted)
        unexplained = restricted.unexplained(sizes.likeliest)[: rows.points]
        dof, last_scale2 = rows.points - restricted.law.directions.shape[1], scale2
        scale2 = max(1.0, float(unexplained @ unexplained) * last_scale2 / dof)
        if abs(scale2 - last_scale2) < tolerance * scale2:
            break
    return sizes._replace(deviance=sizes.deviance + rows.log_det)


def _without_errors(restricted: RestrictedLikelihood) -> _Sizes:
    zero = np.zeros(3)
    return _Sizes(zero, zero, restricted.deviance(zero))


def _likeliest_sizes(restricted: RestrictedLikelihood) -> _Sizes:
    """The likeliest sizes, each sought in turn, and their means."""
    grids = [_SIZES_TRIED, _DURATION_SHARE * _SIZES_TRIED, _SIZES_TRIED]
    sizes, deviance = np.zeros(3), inf
    grid_deviances: list[Floats] = []
    for _ in range(2):
        grid_deviances = []
        for kind, grid in enumerate(grids):
            deviances = restricted.deviances(sizes, kind, np.append(0.0, grid))
            least = int(np.argmin(deviances))
            sizes[kind] = 0.0 if least == 0 else grid[least - 1]
            deviance = float(deviances[least])
            grid_deviances.append(deviances[1:])
    # the mean square over the sizes that the data allow: with few nodes the likeliest is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (grid_deviances[kind] - grid_deviances[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    return _Sizes(sizes, averaged, deviance)


_CHUNK_PLACES = 64
"""Number of half-cycles for which changes are computed together."""
_EDGE_HALF_CYCLES = 5
"""Half-cycles at both ends at which no change is looked for."""
_STEP_PROBABILITY = 0.2
"""Prior probability that a run has a step of the friction."""
_CHANGE_DRIVE_FACTORS = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without changes."""
_MAX_CHANGES = 3
_KINDS = (ChangeKind.FRICTION, ChangeKind.PERIOD)


def with_changes(
    linearised: LinearisedFit, u_step: float, explained: float = 0.0, fit: FitResult | None = None
) -> FitResult:
    """The fit with the changes in its decay, and with the uncertainty by a step of the friction not found.

    A step too small to be found moves the parameters all the same. Their uncertainties hold it in proportion
    to its probability at each half-cycle, so that no uncertainty leaps where a step is found.

    Parameters
    ----------
    u_step
        Prior standard uncertainty of the relative size of a step.
    explained
        Fall of -2 ln L by smooth errors of the law (`DiscrepancySize.against_law`).
    fit
        The fit that receives the changes, where it has terms that `linearised.fit` has not.
    """
    fit = linearised.fit if fit is None else fit
    drives = _with_drives(linearised, _CHANGE_DRIVE_FACTORS) if fit.loss == "linear" else ()
    scans = [scan for noise in drives if (scan := _ChangeScan.of(linearised, noise)) is not None]
    if not scans:
        return fit
    if u_step > 0:
        fit = fit.with_term(
            FRICTION_STEP, linearised.to_physical @ scans[0].hidden_friction(u_step, explained)
        )
    changes = _found_changes(linearised, scans, explained)
    warnings = (f"{change.text}; fit the parts before and after it on their own" for change in changes)
    return replace(fit, changes=(*fit.changes, *changes), warnings=(*fit.warnings, *warnings))


def _found_changes(
    linearised: LinearisedFit, scans: Sequence["_ChangeScan"], explained: float
) -> tuple[Change, ...]:
    points, changes = linearised.points, list[Change]()
    clear_gain = CLEAR_CHANGE_GAIN + 2 * log(len(ChangeKind) * len(points))
    deviance = min(scan.deviance() for scan in scans)
    for _ in range(_MAX_CHANGES):
        best = min((scan.best() for scan in scans), key=lambda change: change.deviance)
        gain = deviance - best.deviance
        # the first change must also explain more than smooth errors of the law
        if not gain > clear_gain + (0.0 if changes else explained):
            break
        place = best.place + _EDGE_HALF_CYCLES
        changes.append(
            Change(
                kind=best.kind,
                half_cycle=int(points.index[place]),
                time_s=float(points.time_s[place]),
                size=float(best.size),
                u_size=float(best.u_size),
                gain=float(gain),
            )
        )
        for scan in scans:
            scan.take(best)
        deviance = min(scan.deviance() for scan in scans)
    return tuple(changes)


class _ClearestChange(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class _ChangeScan:
    """Whitened residuals for one drive, and their derivatives with respect to a change at each half-cycle.

    These are computed anew for each search, some half-cycles at a time: all would fill the memory.
    """

    def __init__(self, linearised: LinearisedFit, noise: Noise, rows: DrivenRows) -> None:
        self._linearised, self._noise = linearised, noise
        model = linearised.model
        self._shares = loss_shares(model, linearised.coordinates)
        time_s = model.points.time_s - model.points.time_s[0]
        # a change lies between its half-cycle and the one before
        between_s = 0.5 * (time_s[1:] + time_s[:-1])
        self._changes_s = between_s[_EDGE_HALF_CYCLES - 1 : len(time_s) - _EDGE_HALF_CYCLES - 1]
        # by the median, which a change hardly moves: it must not hide in a scatter that it makes
        self._scale = max(1.0, robust_scatter(rows.residuals[: rows.points], middle=0.0))
        rows = rows.in_scatter(self._scale)
        self._law = FactoredJacobian(rows.jacobian)
        self._taken: list[FactoredJacobian] = []
        self._left = self._law.residual(rows.residuals)
        self._constant = rows.log_det + self._law.log_det

    @classmethod
    def of(cls, linearised: LinearisedFit, noise: Noise) -> "_ChangeScan | None":
        """The scan for a drive; None where the filter has no value for it, or half-cycles are too few."""
        if len(linearised.points) <= 2 * _EDGE_HALF_CYCLES:
            return None
        rows = DrivenRows.of(linearised.model, linearised.coordinates, noise)
        return cls(linearised, noise, rows) if np.all(np.isfinite(rows.residuals)) else None

    def hidden_friction(self, u_size: float, explained: float) -> Floats:
        """Changes (coordinates, half-cycles) by one standard deviation of a friction step not corrected.

        Prior: a step with the probability `_STEP_PROBABILITY`, at any half-cycle alike, its size zero with
        the standard uncertainty `u_size`. The data weigh each half-cycle by its gain in -2 ln L beyond
        `explained`.
        """
        mean_squares, chances, law_changes = [], [], []
        for first in range(0, len(self._changes_s), _CHUNK_PLACES):
            raw = self._changes(first, _CHUNK_PLACES, whole=True)[:, 0]
            changes = self._law.residual(raw)
            power = np.einsum("rp,rp->p", changes, changes) + 1e-30
            variance = 1.0 / (1.0 / u_size**2 + power)
            size = -variance * (self._left @ changes)
            gain = np.maximum(size**2 / variance - explained, 0.0)
            mean_squares.append(size**2 + variance)
            chances.append(np.exp(np.minimum(0.5 * gain, 300.0)) * np.sqrt(variance) / u_size)
            law_changes.append(self._law.coefficients(raw))
        chance = np.concatenate(chances) * _STEP_PROBABILITY / len(self._changes_s)
        weight = np.concatenate(mean_squares) * chance / (np.sum(chance) + 1.0 - _STEP_PROBABILITY)
        return np.asarray(np.concatenate(law_changes, axis=1) * np.sqrt(weight))

    def _changes(self, first: int, count: int, *, whole: bool = False) -> Floats:
        """Derivatives (rows, 2, half-cycles) by unit steps of friction and period, at `count` half-cycles.

        The part that law and earlier changes take up is subtracted, unless they are to be `whole`.
        """
        changes_s = self._changes_s[first : first + count]

        def loss_errors(amplitude: Floats, node_s: Floats) -> Floats:
            return np.asarray((node_s[:, None] > changes_s) * self._shares(amplitude)[0][:, None])

        def duration_errors(_: Floats, node_s: Floats) -> Floats:
            return np.asarray(1.0 * (node_s[:, None] > changes_s))

        linearised, errors = self._linearised, DiscrepancyColumns(loss_errors, duration_errors)
        rows = DrivenRows.of(linearised.model, linearised.coordinates, self._noise, errors)
        changes = rows.by_errors / self._scale
        if not whole:
            for taken in (self._law, *self._taken):
                changes = taken.residual(changes)
        return changes.reshape(len(changes), 2, -1)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> _ClearestChange:
        """The change that explains most."""
        clearest, deviance = [], self.deviance()
        for first in range(0, len(self._changes_s), _CHUNK_PLACES):
            changes = self._changes(first, _CHUNK_PLACES)
            score = np.einsum("r,rkp->kp", self._left, changes)
            power = np.einsum("rkp,rkp->kp", changes, changes) + 1e-30
            gains = score**2 / power
            for row, kind in enumerate(_KINDS):
                place = int(np.argmax(gains[row]))
                size, u = -score[row, place] / power[row, place], power[row, place] ** -0.5
                with_change = deviance - float(gains[row, place])
                clearest.append(_ClearestChange(kind, first + place, size, u, with_change))
        return min(clearest, key=lambda change: change.deviance)

    def take(self, best: _ClearestChange) -> None:
        """Let a change explain its part of the residuals in all that follows."""
        own = FactoredJacobian(self._changes(best.place, 1)[:, _KINDS.index(best.kind)])
        self._left = own.residual(self._left)
        self._taken.append(own)
