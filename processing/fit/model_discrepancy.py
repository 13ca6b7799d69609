"""How far a law is from what a decay shows, and what that leaves of its parameters.

A law that is not the pendulum's finds its parameters all the same: the residuals hold what they could not
take up, the parameters hold the rest. So the law is given room to err. Loss and duration of a half-swing and
the harmonics of the swing differ from what it says by unknown smooth functions of ln A, relative errors that
lie about zero as a Gaussian process does. How large they are is estimated by the restricted likelihood,
together with the drive of the ground: a law that lacks something otherwise calls it a drive. The values stay
as fitted; their uncertainties grow by what errors of that size do to them.

Of a true law the likeliest size is nought, or not seen, and nothing is widened.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.fit.exact_model import Errors
from processing.fit.result import MISFIT, MISFIT_SEEN, FitResult, Misfit
from processing.fit.terms import Driven, Linearised, Restricted
from processing.least_squares import Factored

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


class _Sizes(NamedTuple):
    """Sizes of the errors of each kind: the likeliest, the mean over what the data allow; and -2 ln L."""

    likeliest: Floats
    averaged: Floats
    deviance: float


def with_misfit(at: Linearised, fit: FitResult | None = None) -> FitResult:
    """The fit with uncertainties that hold how far its law lies from the data.

    `fit` is the fit near whose end this is found where it has further terms already.
    """
    fit = at.fit if fit is None else fit
    misfit, by = _misfit(at)
    if by is None:
        return replace(fit, misfit=misfit)
    wider = fit.with_term(MISFIT, by)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(wider.standard_uncertainty / fit.standard_uncertainty, nan=1.0)
    misfit = replace(misfit, widened=dict(zip(fit.names, factor.tolist(), strict=True)))
    return replace(wider, misfit=misfit, warnings=(*fit.warnings, *_warnings(misfit, factor)))


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


def _misfit(at: Linearised) -> tuple[Misfit, Floats | None]:
    """The misfit, and changes of the values by errors of that size; None where it is not seen."""
    if at.fit.loss != "linear":
        return Misfit(against_law=nan), None
    model = at.model
    nodes = _Nodes(at.points.amplitude / model.reference)
    of_waveform = _by_harmonics(at, nodes)
    own = model.noise_of(at.fit)
    errors = Errors(nodes, nodes)

    def driven(step: float) -> Driven | None:
        found = at.driven(replace(own, step=step), errors)
        if not np.all(np.isfinite(found.residuals)):
            return None
        padded = np.zeros((len(found.residuals), nodes.count))
        padded[found.points :] = of_waveform
        return found._replace(by_errors=np.column_stack([found.by_errors, padded]))

    steps = _drives(own.step, float(np.median(model.u_amplitude)))
    tried = [here for here in map(driven, steps) if here is not None]
    if not tried:
        return Misfit(against_law=nan), None
    best = min((_scaled(here, _sizes, 0.01) for here in tried), key=lambda one: one.deviance)
    # without errors the scatter may be larger instead
    against = min(_scaled(here, _without, 0.001).deviance for here in tried) - best.deviance
    if not against > MISFIT_SEEN:
        return Misfit(against_law=max(against, 0.0)), None
    loss, duration, waveform = best.averaged.tolist()
    misfit = Misfit(loss=loss, duration=duration, waveform=waveform, against_law=float(against))
    # what errors of these sizes do to the values, which were found with the law's own weights
    here = driven(own.step)
    assert here is not None
    here = here.in_scatter(at.scale)
    by = Factored(here.jacobian).coefficients(here.by_errors * np.repeat(best.averaged, nodes.count))
    return misfit, at.to_physical @ by


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


def _drives(own: float, unit: float) -> list[float]:
    """Steps of the drive that are tried, with none."""
    largest = own if own > 0 else 1e-3 * unit
    return [*(largest * 10.0**_STEPS).tolist(), 0.0]


def _by_harmonics(at: Linearised, nodes: _Nodes) -> Floats:
    """Derivatives of the residuals of the evidence by relative errors of the law's harmonics."""
    model, waveform = at.model, at.model.evidence.waveform
    out = np.zeros((len(model.of_evidence(at.coordinates)), nodes.count))
    if waveform is None or model.pendulum is None:
        return out
    predicted = waveform.predicted_rad(model.law, at.values, model.pendulum)
    for column, shape in enumerate(nodes(waveform.amplitude_rad / model.reference).T):
        moved = waveform.reduced(shape[:, None] * predicted)
        out[: len(moved), column] = moved
    return out


def _scaled(here: Driven, judge: Callable[[Restricted], _Sizes], tolerance: float) -> _Sizes:
    """What is found with turning points that scatter as much more than stated as it leaves them to."""
    scale2 = 1.0
    for _ in range(3):
        rows = here.in_scatter(sqrt(scale2))
        restricted = Restricted(rows.residuals, rows.jacobian, np.split(rows.by_errors, 3, axis=1))
        found = judge(restricted)
        rest = restricted.unexplained(found.likeliest)[: rows.points]
        before = scale2
        scale2 = max(1.0, float(rest @ rest) * before / (rows.points - restricted.law.directions.shape[1]))
        if abs(scale2 - before) < tolerance * scale2:
            break
    return found._replace(deviance=found.deviance + rows.log_det)


def _without(here: Restricted) -> _Sizes:
    none = np.zeros(3)
    return _Sizes(none, none, here.deviance(none))


def _sizes(here: Restricted) -> _Sizes:
    """The likeliest sizes, each sought in turn, and their means."""
    grids = [_GRID, _OF_DURATION * _GRID, _GRID]
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
    # the mean square over what the data allow: of few nodes the likeliest size is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (tried[kind] - tried[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    return _Sizes(sizes, averaged, deviance)
