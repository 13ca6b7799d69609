"""The exact fit with an auxiliary seismometer, whose part of the drive is subtracted if it predicts better.

A record that has nothing to do with the ground under the rig must not be used. Gains are judged by
half-cycles that they were not fitted to: gains of an unrelated record make the predictions of those worse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import atan2, hypot, inf, nan
from typing import Annotated, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.decay_summary import mean_period
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.exact import fit_exact
from processing.fit.exact_model import ExactModel
from processing.fit.known_drive import (
    FREE_REST_WEIGHT,
    PAIR,
    SIGNALS,
    SLOPES,
    U_FREE_REST_WEIGHT,
    KnownDrive,
    Seismogram,
    columns_of,
    known_drive,
    signals_of,
)
from processing.fit.result import FitResult
from processing.fit.terms import Term, solve
from processing.least_squares import FactoredJacobian
from processing.quantity import Quantity
from processing.swing import TurningPoints

MIN_PREDICTION_GAIN = 12.0
"""Fall of -2 ln L, of half-cycles that gains were not fitted to, above which the gains are used. With an
unrelated seismometer -2 ln L rises, by about 2 for each gain."""
_MIN_COVERED_SHARE = 0.2
"""Share of the half-swings that the seismometer has to cover."""
_U_DELAY = 0.015
"""Standard uncertainty of a delay, in periods, by unknown details of the measurement of half-cycles: at a
period of 4 s, six recorded runs with a delay of -0.05 s gave 0.06 to 0.09 s more in the mean."""
_MAX_CORRECTIONS = 10
"""Most corrections of a clock; each reduces its error by a tenth of a second or by half."""
_LEFT_OUT_BLOCKS = 10
"""Parts of a run, each of which is predicted by gains fitted to the others."""
_MARGIN_PERIODS = 3.0
"""Periods of the seismometer's record before and after the run that its signals need."""
_SHIFT_PERIODS = 0.02
"""Shift of the signals, in periods, for the derivative with respect to their time."""
_WEIGHT_CHANGE = 0.1
"""Change of the weight of a half-cycle's own samples for the derivative with respect to it."""


class SeismometerVerdict(StrEnum):
    """Whether an auxiliary seismometer was used, and why not."""

    USED = "used"
    NO_GAIN = "refused: it explains nothing of the pendulum's motion"
    ABSENT = "refused: it does not cover the run"


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Response of the pendulum's angular acceleration to a seismometer's component, at its frequency."""

    name: str
    gain: float = nan
    """In rad/s^2 per unit of the component."""
    u_gain: float = nan
    phase_rad: float = nan
    """Lead of the drive over the component, with deflections positive at the first turning point."""
    u_phase_rad: float = nan
    with_slope: bool = False
    """Whether gain and phase may change with frequency."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeismometerUse:
    """Use of an auxiliary seismometer in the fit of a run."""

    source: str = ""
    """Name of its file, or its topic in the record."""
    understood: tuple[str, ...] = ()
    """Remarks on what was read of the file, and what was left out."""
    verdict: SeismometerVerdict = SeismometerVerdict.NO_GAIN
    reason: str = ""
    """Why it does not cover the run, where it does not."""
    gain_of_prediction: Annotated[float, Quantity("", "gain of prediction")] = nan
    """Decrease of -2 ln L of half-cycles with gains fitted to the others."""
    explained: Annotated[float, Quantity("", "share of the drive explained", "%")] = nan
    """Share of the drive's power at the pendulum's frequency that it explains: the squared coherence."""
    ground_alone_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    """Density of the drive without the seismometer."""
    ground_left_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    """Density of the drive that it does not explain."""
    responses: tuple[Response, ...] = ()
    """Response to each component in use."""
    missing_half_cycles: int = 0
    """Half-swings that the seismometer does not cover; the drive is unknown in them."""
    delay_s: Estimate = NOT_DETERMINED
    """Correction of the seismometer's times as the run shows it; it was applied if it exceeds four standard
    uncertainties."""
    clock_drift: Estimate = NOT_DETERMINED
    """The same in s per second from the middle of the run."""
    saved: Mapping[str, float] = field(default_factory=dict)
    """Factor by which the uncertainty of each parameter is smaller."""

    @property
    def used(self) -> bool:
        return self.verdict is SeismometerVerdict.USED

    def with_saved(self, alone: FitResult, fit: FitResult) -> "SeismometerUse":
        """The same with `saved`: the uncertainties of a fit `alone` over those of the fit with it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = alone.standard_uncertainty / fit.standard_uncertainty
        saved = dict(zip(fit.names, ratio.tolist(), strict=True))
        return replace(self, saved={name: saved[name] for name in fit.contact_names})


def _accepted_use(
    use: SeismometerUse, alone: FitResult, fit: FitResult, names: Sequence[str], chosen: Sequence[int]
) -> SeismometerUse:
    """The use with an accepted fit by the `chosen` signals; `names` are those of the components."""
    drive = fit.evidence.drive
    assert drive is not None
    assert drive.covariance is not None
    responses = []
    for component in sorted({column // SIGNALS for column in chosen}):
        first = chosen.index(component * SIGNALS)
        a, b = drive.gains[first], -drive.gains[first + 1]
        gain = hypot(a, b)
        covariance = drive.covariance[first : first + 2, first : first + 2] * np.array([[1, -1], [-1, 1]])
        by_gain, by_phase = np.array([a, b]) / gain, np.array([-b, a]) / gain
        responses.append(
            Response(
                name=names[component],
                gain=gain,
                u_gain=float(np.sqrt(by_gain @ covariance @ by_gain)),
                phase_rad=atan2(b, a),
                u_phase_rad=float(np.sqrt(by_phase @ covariance @ by_phase)) / gain,
                with_slope=columns_of(component, SLOPES)[0] in chosen,
            )
        )
    explained_power = float(np.mean((drive.steps[0][~drive.missing] @ drive.gains) ** 2))
    return replace(
        use.with_saved(alone, fit),
        verdict=SeismometerVerdict.USED,
        explained=float(explained_power / (explained_power + fit.ground_fit.noise.step**2)),
        ground_left_rad_per_s2_rthz=fit.ground_fit.density_rad_per_s2_rthz,
        responses=tuple(responses),
    )


@dataclass(frozen=True)
class SeismometerFit:
    """A fit with an auxiliary seismometer, or without it where it was refused, and its use."""

    fit: FitResult
    use: SeismometerUse


def fit_with_seismometer(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    seismometer: Seismogram,
    alone: FitResult,
    *,
    averaged: bool = True,
) -> SeismometerFit:
    """Fit the exact map with an auxiliary seismometer.

    Parameters
    ----------
    alone
        The exact fit of these points without it, which is returned where the seismometer is refused.
    averaged
        That of `fit_exact`.
    """
    search = _Search(points.first(alone.half_cycles), pendulum, alone, averaged)
    return search.with_corrected_clock(seismometer)


class SignalDrives:
    """The signals of a seismometer, and the drive of a run's turning points by all of them, `drive`."""

    def __init__(self, points: TurningPoints, seismometer: Seismogram, *, averaged: bool) -> None:
        self.period_s = mean_period(points)
        margin_s = _MARGIN_PERIODS * self.period_s
        during_run = seismometer.between(points.time_s[0] - margin_s, points.time_s[-1] + margin_s)
        self.names = seismometer.names
        self.signals = signals_of(during_run, self.period_s)
        self._points, self._averaged = points, averaged
        self.drive = self.changed()

    def changed(
        self, delay_s: float = 0.0, drift: float = 0.0, rest_weight: float = FREE_REST_WEIGHT
    ) -> KnownDrive:
        """The drive by all signals, later by `delay_s` and by `drift` a second from the run's middle, with a
        weight of a half-cycle's own samples in its equilibrium."""
        time = self.signals.time_s
        middle = 0.5 * float(self._points.time_s[0] + self._points.time_s[-1])
        signals = replace(self.signals, time_s=time + delay_s + drift * (time - middle))
        return known_drive(self._points, signals, averaged=self._averaged, rest_weight=rest_weight)


class ClockCorrection(NamedTuple):
    """Correction to add to a seismometer's times, in s, and in s per second from the middle of the run."""

    delay_s: Estimate
    drift: Estimate

    @property
    def significant(self) -> bool:
        """Whether delay or drift is seen, at four standard uncertainties."""
        return any(abs(value) > 4 * u for value, u in self)


class _Selection(NamedTuple):
    """A fit with some of the seismometer's signals, and its gain of prediction by them."""

    fit: FitResult
    chosen: Sequence[int]
    gain: float


@dataclass(frozen=True)
class _Search:
    """Search for the signals of a seismometer that predict a run's turning points, about its fit `alone`."""

    points: TurningPoints
    pendulum: PendulumOnBall
    alone: FitResult
    averaged: bool

    def with_corrected_clock(self, seismometer: Seismogram) -> SeismometerFit:
        """The fit with the seismometer, its clock corrected where the run shows an error of it.

        A slope of the phase is a delay. The clock is therefore corrected before slopes are fitted.
        """
        middle_s = 0.5 * float(self.points.time_s[0] + self.points.time_s[-1])
        delay_s = drift = 0.0
        for corrections in range(_MAX_CORRECTIONS + 1):
            corrected = seismometer.delayed(delay_s, drift, middle_s)
            try:
                drives = SignalDrives(self.points, corrected, averaged=self.averaged)
            except DataError as error:
                return SeismometerFit(
                    self.alone, SeismometerUse(verdict=SeismometerVerdict.ABSENT, reason=str(error))
                )
            use = SeismometerUse(
                missing_half_cycles=int(np.count_nonzero(drives.drive.missing)),
                ground_alone_rad_per_s2_rthz=self.alone.ground_fit.density_rad_per_s2_rthz,
            )
            count = len(drives.drive.missing)
            if use.missing_half_cycles > (1 - _MIN_COVERED_SHARE) * count:
                reason = f"{use.missing_half_cycles} of {count} half-swings have no seismometer"
                return SeismometerFit(
                    self.alone, replace(use, verdict=SeismometerVerdict.ABSENT, reason=reason)
                )
            selection = self._with_signals(drives, _Selection(self.alone, [], 0.0), PAIR)
            if not selection.chosen:
                return SeismometerFit(self.alone, replace(use, gain_of_prediction=selection.gain))
            clock = self._clock_correction(selection.fit, drives, selection.chosen)
            correction = ClockCorrection(
                Estimate(delay_s + clock.delay_s.value, clock.delay_s.standard_uncertainty),
                Estimate(drift + clock.drift.value, clock.drift.standard_uncertainty),
            )
            if corrections == _MAX_CORRECTIONS or not clock.significant:
                break
            delay_s, drift = correction.delay_s.value, correction.drift.value
        selection = self._with_signals(drives, selection, SLOPES)
        u_delay_s = hypot(correction.delay_s.standard_uncertainty, _U_DELAY * drives.period_s)
        delay = Estimate(correction.delay_s.value, u_delay_s)
        use = replace(use, gain_of_prediction=selection.gain, delay_s=delay, clock_drift=correction.drift)
        use = _accepted_use(use, self.alone, selection.fit, drives.names, selection.chosen)
        return SeismometerFit(selection.fit, use)

    def _with_signals(
        self, drives: SignalDrives, selection: _Selection, kinds: tuple[int, ...]
    ) -> _Selection:
        """The selection with further components whose signals of these kinds predict better, the best first.

        Slopes are added only to components in use. Where nothing is selected, the gain is that of the best.
        """
        used = sorted({column // SIGNALS for column in selection.chosen})
        candidates = used if kinds is SLOPES else list(range(len(drives.names)))
        while candidates:
            gains = [
                self._gain(selection.fit, drives, selection.chosen, columns_of(component, kinds))
                for component in candidates
            ]
            best = int(np.argmax(gains))
            if not gains[best] > MIN_PREDICTION_GAIN:
                return selection if selection.chosen else selection._replace(gain=gains[best])
            chosen = [*selection.chosen, *columns_of(candidates.pop(best), kinds)]
            fit = self.fitted_with(selection.fit, drives, chosen)
            selection = _Selection(fit, chosen, selection.gain + gains[best])
        return selection

    def fitted_with(self, near: FitResult, drives: SignalDrives, chosen: Sequence[int]) -> FitResult:
        """The exact fit with some signals, started at an earlier fit with the first of them."""
        return fit_exact(
            self.points,
            self.pendulum,
            law=self.alone.law,
            drag=self.alone.has_drag,
            evidence=replace(self.alone.evidence, drive=self._drive(near, drives, chosen)),
            loss=self.alone.loss,
            averaged=self.averaged,
            near=near,
        )

    @staticmethod
    def _drive(near: FitResult, drives: SignalDrives, chosen: Sequence[int]) -> KnownDrive:
        """The drive by some signals, the first with the gains of an earlier fit and the others at 0."""
        known = np.zeros(0) if near.evidence.drive is None else near.evidence.drive.gains
        gains = np.concatenate([known, np.zeros(len(chosen) - len(known))])
        return drives.drive.select(list(chosen)).with_gains(gains)

    def _residuals(self, fit: FitResult, drive: KnownDrive) -> tuple[Floats, Floats, Floats]:
        """Whitened residuals at a fit with another known drive, and their derivatives by its gains and by the
        other coordinates."""
        evidence = replace(fit.evidence, drive=drive)
        model = ExactModel(self.points, self.pendulum, law=fit.law, drag=fit.has_drag, evidence=evidence)
        assert model.known_drive is not None
        noise = fit.ground_fit.noise
        noise = replace(noise, step=noise.step / model.reference)
        filtered = model.filtered(model.parametrisation.from_physical(fit.named_values), noise)
        by_gains = filtered.jacobian[:, : drive.terms] / model.known_drive.unit
        return filtered.residuals, by_gains, filtered.jacobian[:, drive.terms :]

    def _gain(
        self, fit: FitResult, drives: SignalDrives, chosen: Sequence[int], further: Sequence[int]
    ) -> float:
        """Fall of -2 ln L of blocks of half-cycles by further signals, each time fitted to the other blocks;
        -inf where a residual or its derivative is not finite."""
        drive = self._drive(fit, drives, [*chosen, *further])
        residuals, by_gains, by_law = self._residuals(fit, drive)
        candidates = by_gains[:, len(chosen) :]
        if not np.all(np.isfinite(candidates)) or not np.all(np.isfinite(residuals)):
            return -inf
        law = FactoredJacobian(np.column_stack([by_law, by_gains[:, : len(chosen)]]))
        unexplained, by_candidates = law.residual(residuals), law.residual(candidates)
        count, fall = len(residuals) // 2, 0.0
        blocks = np.tile(np.arange(count) * _LEFT_OUT_BLOCKS // count, 2)
        for block in range(_LEFT_OUT_BLOCKS):
            own = blocks == block
            gains = FactoredJacobian(by_candidates[~own]).coefficients(unexplained[~own])
            predicted = unexplained[own] - by_candidates[own] @ gains
            fall += float(np.sum(unexplained[own] ** 2) - np.sum(predicted**2))
        return fall

    def _clock_correction(
        self, fit: FitResult, drives: SignalDrives, chosen: Sequence[int]
    ) -> ClockCorrection:
        """Correction of the seismometer's clock by a fit with some signals, with free gain and phase.

        A delay shows in the change of the phase within the band to which a half-swing responds. So does the
        weight of a half-cycle's own samples in its equilibrium position, which is known only roughly.
        """
        drive = self._drive(fit, drives, chosen)
        delay_s = _SHIFT_PERIODS * drives.period_s
        drift = delay_s / (0.5 * float(self.points.time_s[-1] - self.points.time_s[0]))
        derivatives = []
        for name, middle, size in (
            ("delay_s", 0.0, delay_s),
            ("drift", 0.0, drift),
            ("rest_weight", FREE_REST_WEIGHT, _WEIGHT_CHANGE),
        ):
            larger, smaller = (drives.changed(**{name: middle + change}) for change in (size, -size))
            change = (larger.steps - smaller.steps)[:, :, list(chosen)] @ drive.gains / (2 * size)
            derivatives.append(np.where(larger.missing | smaller.missing, 0.0, change))
        count = len(derivatives)
        with_derivatives = KnownDrive(
            np.concatenate([drive.steps, np.stack(derivatives, axis=2)], axis=2),
            drive.missing,
            np.concatenate([drive.gains, np.zeros(count)]),
        )
        residuals, by_gains, by_law = self._residuals(fit, with_derivatives)
        fitted = np.column_stack([by_law, by_gains[:, :-count]])
        clock = Term("clock", by_gains[:, -3:-1])
        rest_weight = Term("rest weight", by_gains[:, -1:], U_FREE_REST_WEIGHT)
        solution = solve(residuals, fitted, [clock, rest_weight])
        u = np.sqrt(np.diag(solution.covariance)) * solution.scatter(fit.dof)
        return ClockCorrection(*(Estimate(float(solution.values[k]), float(u[k])) for k in range(2)))
