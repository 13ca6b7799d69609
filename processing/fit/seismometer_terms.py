"""The signals of an auxiliary seismometer as terms of an exact fit, and the errors of its clock.

The instrument's response is not known. Near the pendulum's frequency two numbers describe it: a gain, and one
for the same record with every phase turned by a quarter; and two more where gain or phase change within the
band over which a half-swing responds to the ground. Its clock is fitted with them: a delay and a
drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, inf
from typing import NamedTuple

import numpy as np

from processing.arrays import Flags, Floats
from processing.contact import PendulumOnBall
from processing.decay_summary import mean_period
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.exact_model import ExactModel
from processing.fit.known_drive import (
    FREE_REST_WEIGHT,
    U_FREE_REST_WEIGHT,
    KnownDrive,
    Signals,
    known_drive,
)
from processing.fit.result import FitResult
from processing.fit.terms import Term, solve
from processing.least_squares import FactoredJacobian
from processing.swing import TurningPoints

_MAX_STEP_PERIODS = 0.25
"""Longest step between samples, in periods: a parabola through three of them still follows a swing."""
_MIN_STEP_PERIODS = 1 / 80
"""Step, in periods, to which finer samples are averaged, which reduces the gain by 3e-4."""
_MIN_GAP_STEPS = 1.6
"""Distance of two samples, in median steps, above which samples are missing between them."""
_GUARD_PERIODS = 0.5
"""Periods on either side of a gap that are not used, since the interpolation in the gap changes them."""
_MAX_DRIFT_FREQUENCY = 1 / 8
"""Frequency over the pendulum's below which a record is taken as its instrument's drift."""
_PADDED_PERIODS = 16
"""Periods by which a record is mirrored at its ends."""


@dataclass(frozen=True, eq=False)
class Seismogram:
    """Samples of an auxiliary seismometer, near the rig or not far from it.

    Times (n,) in s on the clock of the turning points, rising; values (n, components) in any unit, NaN where
    missing; a name for each component.
    """

    time_s: Floats
    value: Floats
    names: tuple[str, ...]

    def delayed(self, by_s: float, drift: float = 0.0, about_s: float = 0.0) -> "Seismogram":
        """The same with times later by `by_s`, and by further `drift` for each second after `about_s`."""
        return replace(self, time_s=self.time_s + by_s + drift * (self.time_s - about_s))

    def between(self, first_s: float, last_s: float) -> "Seismogram":
        """The samples within these times."""
        low, high = np.searchsorted(self.time_s, (first_s, last_s)).tolist()
        return replace(self, time_s=self.time_s[low:high], value=self.value[low:high])


SIGNALS = 4
"""Number of signals made of a component: for gain, quadrature, and the slopes of both over the frequency."""
PAIR, SLOPES = (0, 1), (2, 3)
"""Gain and quadrature, and their slopes, among the signals of a component."""


def columns_of(component: int, kinds: Sequence[int]) -> list[int]:
    """Columns of some of a component's signals among those of all components."""
    return [component * SIGNALS + kind for kind in kinds]


def signals_of(seismometer: Seismogram, period_s: float) -> Signals:
    """Every component's signals.

    Raises DataError for samples that are too few or too far apart.
    """
    time, value, step_s = _even(seismometer, period_s)
    good = np.all(np.isfinite(value), axis=1)
    if np.count_nonzero(good) * step_s < 4 * period_s:
        raise DataError(
            f"the seismometer has {np.count_nonzero(good) * step_s:.3g} s of samples beside the run; at "
            f"least four periods ({4 * period_s:.3g} s) are needed"
        )
    filled = np.column_stack([np.interp(time, time[good], one[good]) for one in value.T])
    padding = min(ceil(_PADDED_PERIODS * period_s / step_s), len(time) - 1)
    filled -= filled.mean(axis=0)
    padded = np.pad(filled, ((padding, padding), (0, 0)), mode="reflect", reflect_type="odd")
    padded -= np.linspace(padded[0], padded[-1], len(padded))
    spectrum = np.fft.rfft(padded, axis=0)
    nu = np.fft.rfftfreq(len(padded), step_s)[:, None] * period_s
    spectrum *= 1.0 - np.exp(-((nu / _MAX_DRIFT_FREQUENCY) ** 2))
    slope = np.clip(nu - 1.0, -1.0, 1.0)
    turned = -1j * spectrum
    kinds = np.stack([spectrum, turned, slope * spectrum, slope * turned], axis=2)
    found = np.fft.irfft(kinds.reshape(len(nu), -1), len(padded), axis=0)
    found = found[padding : padding + len(time)]
    usable = ~_dilate(~good, ceil(_GUARD_PERIODS * period_s / step_s))
    return Signals(time[usable], np.ascontiguousarray(found[usable]), _MIN_GAP_STEPS * step_s)


def plain_signals(seismometer: Seismogram, period_s: float) -> Signals:
    """Every component unchanged but for its drift, which is removed."""
    return signals_of(seismometer, period_s).select([one * SIGNALS for one in range(len(seismometer.names))])


def _even(seismometer: Seismogram, period_s: float) -> tuple[Floats, Floats, float]:
    """Times, values (NaN where missing) and step in s of the samples at an even rate."""
    time, value = seismometer.time_s, seismometer.value
    if len(time) < 3:
        raise DataError(f"the seismometer has {len(time)} samples beside the run: their times do not overlap")
    steps = np.diff(time)
    step_s = float(np.median(steps))
    if step_s > _MAX_STEP_PERIODS * period_s:
        raise DataError(
            f"the seismometer has a sample every {step_s:.3g} s; the pendulum's period of {period_s:.3g} s "
            f"needs one every {_MAX_STEP_PERIODS * period_s:.2g} s at least"
        )
    count = round((time[-1] - time[0]) / step_s) + 1
    even = time[0] + step_s * np.arange(count)
    before = np.clip(np.searchsorted(time, even, side="right") - 1, 0, len(time) - 2)
    lost = steps[before] > _MIN_GAP_STEPS * step_s
    found = np.column_stack([np.interp(even, time, one) for one in value.T])
    found[lost] = np.nan
    together = int(_MIN_STEP_PERIODS * period_s / step_s)
    if together < 2:
        return even, found, step_s
    kept = count // together * together
    even = even[:kept].reshape(-1, together).mean(axis=1)
    return even, found[:kept].reshape(len(even), together, -1).mean(axis=1), step_s * together


def _dilate(lost: Flags, guard: int) -> Flags:
    """Whether each sample is at most `guard` samples from a lost one."""
    count = np.concatenate([[0], np.cumsum(lost)])
    places = np.arange(len(lost))
    low, high = np.maximum(places - guard, 0), np.minimum(places + guard + 1, len(lost))
    return np.asarray(count[high] > count[low])


_LEFT_OUT_BLOCKS = 10
"""Parts of a run, each of which is predicted by gains fitted to the others."""
_MARGIN_PERIODS = 3.0
"""Periods of the seismometer's record before and after the run that its signals need."""
_SHIFT_PERIODS = 0.02
"""Shift of the signals, in periods, for the derivative with respect to their time."""
_WEIGHT_CHANGE = 0.1
"""Change of the weight of a half-cycle's own samples for the derivative with respect to it."""


class SignalDrives:
    """The signals of a seismometer, and the drive of a run's turning points by `every` one of them."""

    def __init__(self, points: TurningPoints, seismometer: Seismogram, *, averaged: bool) -> None:
        self.period_s = mean_period(points)
        margin_s = _MARGIN_PERIODS * self.period_s
        beside = seismometer.between(points.time_s[0] - margin_s, points.time_s[-1] + margin_s)
        self.names = seismometer.names
        self.signals = signals_of(beside, self.period_s)
        self._points, self._averaged = points, averaged
        self.every = known_drive(points, self.signals, averaged=averaged)

    def later(self, by_s: float, stretched: float = 0.0) -> KnownDrive:
        """The drive by all signals, later by `by_s` and by `stretched` a second from the run's middle."""
        time = self.signals.time_s
        middle = 0.5 * float(self._points.time_s[0] + self._points.time_s[-1])
        moved = replace(self.signals, time_s=time + by_s + stretched * (time - middle))
        return known_drive(self._points, moved, averaged=self._averaged)

    def with_rest_weight(self, weight: float) -> KnownDrive:
        """The drive by all signals with another weight of a half-cycle's own samples in its equilibrium."""
        return known_drive(self._points, self.signals, averaged=self._averaged, rest_weight=weight)


def with_start_gains(drives: SignalDrives, near: FitResult, chosen: Sequence[int]) -> KnownDrive:
    """The drive by some signals, the first with the gains of an earlier fit and the others at 0."""
    known = np.zeros(0) if near.evidence.drive is None else near.evidence.drive.gains
    gains = np.concatenate([known, np.zeros(len(chosen) - len(known))])
    return drives.every.select(list(chosen)).with_gains(gains)


def model_of(
    points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult, drive: KnownDrive
) -> ExactModel:
    """The model of a fit with another known drive."""
    evidence = replace(fit.evidence, drive=drive)
    return ExactModel(points, pendulum, law=fit.law, drag=fit.has_drag, evidence=evidence)


def residuals_at_fit(model: ExactModel, fit: FitResult) -> tuple[Floats, Floats, Floats]:
    """Whitened residuals at a fit, their Jacobians of the gains of the drive and of the other columns."""
    assert model.known_drive is not None
    assert fit.ground is not None
    noise = replace(fit.ground.noise, step=fit.ground.noise.step / model.reference)
    found = model.filtered(model.columns.from_physical(fit.named_values), noise)
    by_gains = found.jacobian[:, : model.known_drive.terms] / model.known_drive.unit
    return found.residuals, by_gains, found.jacobian[:, model.known_drive.terms :]


def gain_of_prediction(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    fit: FitResult,
    drives: SignalDrives,
    chosen: Sequence[int],
    more: Sequence[int],
) -> float:
    """Fall of -2 ln L of blocks of half-cycles by further signals, each time fitted to the other blocks.

    -inf where a residual or its derivative is not finite.
    """
    drive = with_start_gains(drives, fit, [*chosen, *more])
    residuals, by_gains, by_law = residuals_at_fit(model_of(points, pendulum, fit, drive), fit)
    candidates = by_gains[:, len(chosen) :]
    if not np.all(np.isfinite(candidates)) or not np.all(np.isfinite(residuals)):
        return -inf
    law = FactoredJacobian(np.column_stack([by_law, by_gains[:, : len(chosen)]]))
    left, of = law.left(residuals), law.left(candidates)
    count = len(residuals) // 2
    block = np.tile(np.arange(count) * _LEFT_OUT_BLOCKS // count, 2)
    fall = 0.0
    for one in range(_LEFT_OUT_BLOCKS):
        here = block == one
        gains = FactoredJacobian(of[~here]).coefficients(left[~here])
        fall += float(np.sum(left[here] ** 2) - np.sum((left[here] - of[here] @ gains) ** 2))
    return fall


class ClockCorrection(NamedTuple):
    """Correction to add to a seismometer's times, in s, and in s per second from the middle of the run."""

    delay_s: Estimate
    drift: Estimate

    @property
    def significant(self) -> bool:
        """Whether delay or drift is seen, at four standard uncertainties."""
        return any(abs(one.value) > 4 * one.standard_uncertainty for one in self)


def clock_correction(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    fit: FitResult,
    drives: SignalDrives,
    chosen: Sequence[int],
) -> ClockCorrection:
    """Correction of the seismometer's clock by a fit with some signals, with free gain and phase.

    A delay turns phases in proportion to the frequency. At the pendulum's frequency the quadrature takes that
    up; the delay shows in the change of the phase within the band to which a half-swing responds. So does the
    weight of a half-cycle's own samples in its equilibrium position, which is known only roughly.
    """
    drive = with_start_gains(drives, fit, chosen)
    by_s = _SHIFT_PERIODS * drives.period_s
    half_s = 0.5 * float(points.time_s[-1] - points.time_s[0])
    moved = []
    heavier, lighter = FREE_REST_WEIGHT + _WEIGHT_CHANGE, FREE_REST_WEIGHT - _WEIGHT_CHANGE
    for late, early, size in (
        (drives.later(by_s), drives.later(-by_s), by_s),
        (drives.later(0.0, by_s / half_s), drives.later(0.0, -by_s / half_s), by_s / half_s),
        (drives.with_rest_weight(heavier), drives.with_rest_weight(lighter), _WEIGHT_CHANGE),
    ):
        change = (late.steps - early.steps)[:, :, list(chosen)] @ drive.gains / (2 * size)
        moved.append(np.where(late.missing | early.missing, 0.0, change))
    both = KnownDrive(
        np.concatenate([drive.steps, np.stack(moved, axis=2)], axis=2),
        drive.missing,
        np.concatenate([drive.gains, np.zeros(len(moved))]),
    )
    residuals, by_gains, by_law = residuals_at_fit(model_of(points, pendulum, fit, both), fit)
    fitted = np.column_stack([by_law, by_gains[:, : -len(moved)]])
    clock = Term("clock", by_gains[:, -3:-1])
    found = solve(residuals, fitted, [clock, Term("rest weight", by_gains[:, -1:], U_FREE_REST_WEIGHT)])
    u = np.sqrt(np.diag(found.covariance)) * found.scatter(fit.dof)
    delay_s, drift = (Estimate(float(found.values[k]), float(u[k])) for k in range(2))
    return ClockCorrection(delay_s, drift)
