"""How a decay departs from its law: by smooth errors of the law, and by events that are found and dated.

An event is sought at every half-cycle: a step of the friction, a step of the period. Each is judged by the
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

_NODE_SPACING = 0.4
"""Largest distance of an error's nodes, in ln A."""
_CORRELATION_LENGTH = 2.0
"""Distance in ln A over which errors are correlated: a wrong exponent or a missing term bends slowly."""
_SIZES_TRIED = 10.0 ** np.arange(-5.0, 0.51, 0.25)
"""Relative errors that are tried, of losses and harmonics; those of durations are times `_DURATION_SHARE`."""
_DURATION_SHARE = 1e-3
_ERROR_DRIVE_FACTORS = (*10.0 ** np.arange(0.0, -3.01, -0.25), 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without errors."""
_DIAGONAL_EXCESS = 1e-9
"""Added to the diagonal of a correlation matrix, so that rounding leaves it a root."""


class _Sizes(NamedTuple):
    """Sizes (3,) of the errors of losses, durations and harmonics; `deviance` is -2 ln L of the likeliest.

    `averaged` is the rms over the sizes that the data allow.
    """

    likeliest: Floats
    averaged: Floats
    deviance: float


def with_discrepancy(at: LinearisedFit, fit: FitResult | None = None) -> FitResult:
    """The fit with uncertainties that contain its law's discrepancy from the data.

    `fit` is the fit that receives the term, where it has terms that `at.fit` has not.
    """
    fit = at.fit if fit is None else fit
    discrepancy, by = _discrepancy(at)
    if by is None:
        return replace(fit, discrepancy=discrepancy)
    wider = fit.with_term(DISCREPANCY, by)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(wider.standard_uncertainty / fit.standard_uncertainty, nan=1.0)
    discrepancy = replace(discrepancy, u_inflation=dict(zip(fit.names, factor.tolist(), strict=True)))
    return replace(wider, discrepancy=discrepancy, warnings=(*fit.warnings, *_warnings(discrepancy, factor)))


def _warnings(discrepancy: DiscrepancySize, factor: Floats) -> tuple[str, ...]:
    parts = [
        f"its {name} by {float(f'{100 * size:.2g}'):g} %"
        for name, size in (
            ("losses", discrepancy.loss),
            ("durations", discrepancy.duration),
            ("harmonics", discrepancy.waveform),
        )
        if size
    ]
    text = (
        f"the law does not describe this decay (chi2 {discrepancy.against_law:.0f} against it): it misses "
        f"{', '.join(parts)}; uncertainties are widened for it by up to {factor.max():.2g}"
    )
    return (text,)


def _discrepancy(at: LinearisedFit) -> tuple[DiscrepancySize, Floats | None]:
    """The discrepancy, and changes of the values by errors of its size; None where it is not seen."""
    if at.fit.loss != "linear":
        return DiscrepancySize(against_law=nan), None
    model = at.model
    nodes = _HatFunctions(at.points.amplitude / model.reference)
    of_waveform = _by_harmonics(at, nodes)
    errors = DiscrepancyColumns(nodes, nodes)

    def driven(noise: Noise) -> DrivenRows | None:
        found = DrivenRows.of(model, at.coordinates, noise, errors, of_waveform)
        return found if np.all(np.isfinite(found.residuals)) else None

    tried = [here for here in map(driven, _with_drives(at, _ERROR_DRIVE_FACTORS)) if here is not None]
    if not tried:
        return DiscrepancySize(against_law=nan), None
    best = min((_scaled(here, _likeliest_sizes, 0.01) for here in tried), key=lambda one: one.deviance)
    # without errors the scatter may be larger instead
    against = min(_scaled(here, _without_errors, 0.001).deviance for here in tried) - best.deviance
    if not against > DISCREPANCY_SEEN:
        return DiscrepancySize(against_law=max(against, 0.0)), None
    loss, duration, waveform = best.averaged.tolist()
    discrepancy = DiscrepancySize(loss=loss, duration=duration, waveform=waveform, against_law=float(against))
    # the effect of errors of these sizes on the values, which were fitted with the law's own weights
    here = driven(at.noise)
    assert here is not None
    here = here.in_scatter(at.scale)
    by = FactoredJacobian(here.jacobian).coefficients(here.by_errors * np.repeat(best.averaged, nodes.count))
    return discrepancy, at.to_physical @ by


class _HatFunctions:
    """Smooth functions of ln A: linear interpolation between even nodes, with correlated values at them."""

    def __init__(self, amplitude: Floats) -> None:
        x = np.log(amplitude)
        count = max(3, int(np.ceil(np.ptp(x) / _NODE_SPACING)) + 1)
        self._at = np.linspace(x.min(), x.max(), count)
        apart = np.abs(self._at[:, None] - self._at) / _CORRELATION_LENGTH
        correlation = np.exp(-0.5 * apart**2) + _DIAGONAL_EXCESS * np.eye(count)
        self._root = np.linalg.cholesky(correlation)
        self.count = count

    def __call__(self, amplitude: Floats, _: Floats | None = None) -> Floats:
        """Values (n, m) of m independent unit errors."""
        x = np.clip(np.log(amplitude), self._at[0], self._at[-1])
        width = self._at[1] - self._at[0]
        hats = np.maximum(0.0, 1.0 - np.abs(x[:, None] - self._at) / width)
        return np.asarray(hats @ self._root)


def _with_drives(at: LinearisedFit, factors: Iterable[float]) -> list[Noise]:
    """The fit's noise with drives of the ground over the likeliest one; where that is 0, over a small one."""
    own = at.noise
    largest = own.step if own.step > 0 else 1e-3 * float(np.median(at.model.u_amplitude))
    return [replace(own, step=largest * factor) for factor in factors]


def _by_harmonics(at: LinearisedFit, nodes: _HatFunctions) -> Floats:
    """The evidence's derivatives with respect to relative errors of losses, durations (0) and harmonics."""
    model, waveform = at.model, at.model.evidence.waveform
    out = np.zeros((len(model.evidence_residuals(at.coordinates)), 3 * nodes.count))
    if waveform is None:
        return out
    predicted = waveform.predicted_rad(model.law, model.values(at.coordinates), model.pendulum)
    for column, shape in enumerate(nodes(waveform.amplitude_rad / model.reference).T, 2 * nodes.count):
        moved = waveform.reduced(shape[:, None] * predicted)
        out[: len(moved), column] = moved
    return out


def _scaled(here: DrivenRows, judge: Callable[[RestrictedLikelihood], _Sizes], tolerance: float) -> _Sizes:
    """Sizes by `judge`, for turning points that scatter as much as their residuals with these sizes do."""
    scale2 = 1.0
    for _ in range(3):
        rows = here.in_scatter(sqrt(scale2))
        restricted = RestrictedLikelihood(rows.residuals, rows.jacobian, np.split(rows.by_errors, 3, axis=1))
        found = judge(restricted)
        rest = restricted.unexplained(found.likeliest)[: rows.points]
        before = scale2
        scale2 = max(1.0, float(rest @ rest) * before / (rows.points - restricted.law.directions.shape[1]))
        if abs(scale2 - before) < tolerance * scale2:
            break
    return found._replace(deviance=found.deviance + rows.log_det)


def _without_errors(here: RestrictedLikelihood) -> _Sizes:
    none = np.zeros(3)
    return _Sizes(none, none, here.deviance(none))


def _likeliest_sizes(here: RestrictedLikelihood) -> _Sizes:
    """The likeliest sizes, each sought in turn, and their means."""
    grids = [_SIZES_TRIED, _DURATION_SHARE * _SIZES_TRIED, _SIZES_TRIED]
    sizes, deviance = np.zeros(3), inf
    tried: list[Floats] = []
    for _ in range(2):
        tried = []
        for kind, grid in enumerate(grids):
            found = here.deviances(sizes, kind, np.append(0.0, grid))
            least = int(np.argmin(found))
            sizes[kind] = 0.0 if least == 0 else grid[least - 1]
            deviance = float(found[least])
            tried.append(found[1:])
    # the mean square over the sizes that the data allow: with few nodes the likeliest is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (tried[kind] - tried[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    return _Sizes(sizes, averaged, deviance)


_CHUNK_PLACES = 64
"""Places at which changes are computed together."""
_EDGE_HALF_CYCLES = 5
"""Half-cycles at both ends at which no change is looked for."""
_STEP_PROBABILITY = 0.2
"""Prior probability that a run has a step of the friction."""
_CHANGE_DRIVE_FACTORS = (1.0, 0.3, 0.1, 0.03, 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without changes."""
_MOST_CHANGES = 3
_KINDS = (ChangeKind.FRICTION, ChangeKind.PERIOD)


def with_changes(
    at: LinearisedFit, u_step: float, explained: float = 0.0, fit: FitResult | None = None
) -> FitResult:
    """The fit with the events in its decay, and with the uncertainty by a step of the friction not found.

    A step too small to be found moves the parameters all the same. Their uncertainties hold it in proportion
    to its probability at each place, so that no uncertainty leaps where a step is found.

    Parameters
    ----------
    u_step
        Prior standard uncertainty of the relative size of a step.
    explained
        By how much -2 ln L is smaller with smooth errors of the law (`DiscrepancySize.against_law`).
    fit
        The fit that receives the changes, where it has terms that `at.fit` has not.
    """
    fit = at.fit if fit is None else fit
    drives = _with_drives(at, _CHANGE_DRIVE_FACTORS) if fit.loss == "linear" else ()
    scans = [scan for noise in drives if (scan := _ChangeScan.of(at, noise)) is not None]
    if not scans:
        return fit
    if u_step > 0:
        fit = fit.with_term(FRICTION_STEP, at.to_physical @ scans[0].hidden_friction(u_step, explained))
    changes = _found_changes(at, scans, explained)
    warnings = (f"{one.text}; fit the parts before and after it on their own" for one in changes)
    return replace(fit, changes=(*fit.changes, *changes), warnings=(*fit.warnings, *warnings))


def _found_changes(at: LinearisedFit, scans: Sequence["_ChangeScan"], explained: float) -> tuple[Change, ...]:
    chance = 2 * log(len(ChangeKind) * len(at.points))
    found: list[Change] = []
    before = min(scan.deviance() for scan in scans)
    for _ in range(_MOST_CHANGES):
        best = min((scan.best() for scan in scans), key=lambda one: one.deviance)
        gain = before - best.deviance
        if not gain > CLEAR_CHANGE_GAIN + chance or not (
            found or gain > CLEAR_CHANGE_GAIN + chance + explained
        ):
            break
        found.append(_change(at, best, gain))
        for scan in scans:
            scan.take(best)
        before = min(scan.deviance() for scan in scans)
    return tuple(found)


def _change(at: LinearisedFit, best: "_ClearestChange", gain: float) -> Change:
    place = best.place + _EDGE_HALF_CYCLES
    points = at.points
    return Change(
        kind=best.kind,
        half_cycle=int(points.index[place]),
        time_s=float(points.time_s[place]),
        size=float(best.size),
        u_size=float(best.u_size),
        gain=float(gain),
    )


class _ClearestChange(NamedTuple):
    """The clearest change of one scan."""

    kind: ChangeKind
    place: int
    size: float
    u_size: float
    deviance: float


class _ChangeScan:
    """Whitened residuals for one drive, and their derivatives with respect to a change at each place.

    The derivatives are computed anew for each search, some places at a time: all of a long decay's would fill
    the memory.
    """

    def __init__(self, at: LinearisedFit, noise: Noise, rows: DrivenRows) -> None:
        self._at, self._noise = at, noise
        model = at.model
        self._shares = loss_shares(model, at.coordinates)
        time_s = model.points.time_s - model.points.time_s[0]
        # a change lies between the half-cycle before its place and the one at it
        self._places_s = (
            0.5 * (time_s[1:] + time_s[:-1])[_EDGE_HALF_CYCLES - 1 : len(time_s) - _EDGE_HALF_CYCLES - 1]
        )
        # by the median, which a change hardly moves: it must not hide in a scatter that it makes
        self._scale = max(1.0, robust_scatter(rows.residuals[: rows.points], middle=0.0))
        rows = rows.in_scatter(self._scale)
        self._law = FactoredJacobian(rows.jacobian)
        self._taken: list[FactoredJacobian] = []
        self._left = self._law.left(rows.residuals)
        self._constant = rows.log_det + self._law.log_det

    @classmethod
    def of(cls, at: LinearisedFit, noise: Noise) -> "_ChangeScan | None":
        """None where the filter has no value for this drive, or there is no place to look at."""
        if len(at.points) <= 2 * _EDGE_HALF_CYCLES:
            return None
        rows = DrivenRows.of(at.model, at.coordinates, noise)
        return cls(at, noise, rows) if np.all(np.isfinite(rows.residuals)) else None

    def hidden_friction(self, u_size: float, explained: float) -> Floats:
        """Changes (coordinates, places) by one standard deviation of a friction step that was not corrected.

        Prior: a step with the probability `_STEP_PROBABILITY`, at any place alike, its size zero with the
        standard uncertainty `u_size`. The data weigh each place by its gain in -2 ln L beyond `explained`.
        """
        sizes, chances, moved = [], [], []
        for first in range(0, len(self._places_s), _CHUNK_PLACES):
            raw = self._changes(first, _CHUNK_PLACES, whole=True)[:, 0]
            changes = self._law.left(raw)
            power = np.einsum("rp,rp->p", changes, changes) + 1e-30
            variance = 1.0 / (1.0 / u_size**2 + power)
            size = -variance * (self._left @ changes)
            gain = np.maximum(size**2 / variance - explained, 0.0)
            sizes.append(size**2 + variance)
            chances.append(np.exp(np.minimum(0.5 * gain, 300.0)) * np.sqrt(variance) / u_size)
            moved.append(self._law.coefficients(raw))
        chance = np.concatenate(chances) * _STEP_PROBABILITY / len(self._places_s)
        weight = np.concatenate(sizes) * chance / (np.sum(chance) + 1.0 - _STEP_PROBABILITY)
        return np.asarray(np.concatenate(moved, axis=1) * np.sqrt(weight))

    def _changes(self, first: int, count: int, *, whole: bool = False) -> Floats:
        """Derivatives (rows, 2, places) by unit steps of friction and period at `count` places from `first`.

        They are without what law and earlier changes take up, unless they are to be `whole`.
        """
        here_s = self._places_s[first : first + count]

        def loss_errors(amplitude: Floats, node_s: Floats) -> Floats:
            return np.asarray((node_s[:, None] > here_s) * self._shares(amplitude)[0][:, None])

        def duration_errors(_: Floats, node_s: Floats) -> Floats:
            return np.asarray(1.0 * (node_s[:, None] > here_s))

        at, errors = self._at, DiscrepancyColumns(loss_errors, duration_errors)
        changes = DrivenRows.of(at.model, at.coordinates, self._noise, errors).by_errors / self._scale
        if not whole:
            for taken in (self._law, *self._taken):
                changes = taken.left(changes)
        return changes.reshape(len(changes), 2, -1)

    def deviance(self) -> float:
        """-2 ln L without any further change."""
        return self._constant + float(self._left @ self._left)

    def best(self) -> _ClearestChange:
        """The change that explains most."""
        found, now = [], self.deviance()
        for first in range(0, len(self._places_s), _CHUNK_PLACES):
            changes = self._changes(first, _CHUNK_PLACES)
            score = np.einsum("r,rkp->kp", self._left, changes)
            power = np.einsum("rkp,rkp->kp", changes, changes) + 1e-30
            gains = score**2 / power
            for at, kind in enumerate(_KINDS):
                place = int(np.argmax(gains[at]))
                size, u = -score[at, place] / power[at, place], power[at, place] ** -0.5
                found.append(_ClearestChange(kind, first + place, size, u, now - float(gains[at, place])))
        return min(found, key=lambda one: one.deviance)

    def take(self, best: _ClearestChange) -> None:
        """Let a change explain its part of the residuals in all that follows."""
        own = FactoredJacobian(self._changes(best.place, 1)[:, _KINDS.index(best.kind)])
        self._left = own.left(self._left)
        self._taken.append(own)
