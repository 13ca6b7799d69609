"""The exact fit with an auxiliary seismometer, whose part of the drive is taken off where predictions gain.

A record that has nothing to do with the ground under the rig must not help. Gains are judged by half-cycles
that they were not fitted to: gains of an unrelated record make the predictions of those worse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from math import atan2, hypot, nan
from typing import Annotated, NamedTuple

import numpy as np

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.exact import fit_exact
from processing.fit.result import FitResult
from processing.fit.seismometer_terms import (
    PAIR,
    SIGNALS,
    SLOPES,
    ClockCorrection,
    Seismogram,
    SignalDrives,
    clock_correction,
    columns_of,
    gain_of_prediction,
    with_start_gains,
)
from processing.quantity import Quantity
from processing.swing import TurningPoints

MIN_PREDICTION_GAIN = 12.0
"""Fall of -2 ln L, of half-cycles that gains were not fitted to, above which the gains are used. With an
unrelated seismometer -2 ln L rises, by about 2 for each gain."""
_MIN_COVERED_SHARE = 0.2
"""Share of the half-swings that the seismometer has to cover."""
_U_DELAY = 0.015
"""Standard uncertainty of a delay, in periods, from what is not known of the measurement of half-cycles: at a
period of 4 s, six recorded runs with a delay of -0.05 s gave 0.06 to 0.09 s more in the mean."""
_MAX_CORRECTIONS = 10
"""Most corrections of a clock; each reduces its error by a tenth of a second or by half."""


class SeismometerVerdict(StrEnum):
    """Whether an auxiliary seismometer was used, and why not."""

    USED = "used"
    NO_GAIN = "refused: it explains nothing of the pendulum's motion"
    ABSENT = "refused: it does not cover the run"


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Response of the pendulum's angular acceleration to a seismometer's component, at its frequency.

    `gain` is in rad/s^2 per unit of the component; `phase_rad` is the lead of the drive over it, with
    deflections positive at the first turning point. `with_slope` is whether both may change with frequency.
    """

    name: str
    gain: float = nan
    u_gain: float = nan
    phase_rad: float = nan
    u_phase_rad: float = nan
    with_slope: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SeismometerUse:
    """Use of an auxiliary seismometer in the fit of a run.

    Attributes
    ----------
    source, understood
        Name of its file, or its place in the record; what was read of it, and what was left out.
    gain_of_prediction
        Decrease of -2 ln L of half-cycles with gains fitted to the others.
    explained
        Share of the drive's power at the pendulum's frequency that it explains: the squared coherence.
    ground_alone, ground_left
        Densities of the drive without the seismometer, and of the remainder, rad/s^2/sqrt(Hz).
    missing_half_cycles
        Half-swings that the seismometer does not cover; the drive is unknown in them.
    delay_s, clock_drift
        Correction of the seismometer's times, in s and in s per second from the middle of the run, as the run
        shows it; it was applied if it exceeds four standard uncertainties.
    saved
        Factor by which the uncertainty of each parameter is smaller.
    """

    source: str = ""
    understood: tuple[str, ...] = ()
    verdict: SeismometerVerdict = SeismometerVerdict.NO_GAIN
    reason: str = ""
    gain_of_prediction: Annotated[float, Quantity("", "gain of prediction")] = nan
    explained: Annotated[float, Quantity("", "share of the drive explained", "%")] = nan
    ground_alone_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    ground_left_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    responses: tuple[Response, ...] = ()
    missing_half_cycles: int = 0
    delay_s: Estimate = NOT_DETERMINED
    clock_drift: Estimate = NOT_DETERMINED
    saved: Mapping[str, float] = field(default_factory=dict)

    @property
    def used(self) -> bool:
        return self.verdict is SeismometerVerdict.USED

    def with_saved(self, alone: FitResult, fit: FitResult) -> "SeismometerUse":
        """The same with `saved`: the uncertainties of a fit `alone` over those of the fit with it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = alone.standard_uncertainty / fit.standard_uncertainty
        saved = dict(zip(fit.names, ratio.tolist(), strict=True))
        return replace(self, saved={name: saved[name] for name in fit.contact_names})


def accepted_use(
    use: SeismometerUse,
    alone: FitResult,
    fit: FitResult,
    names: Sequence[str],
    chosen: Sequence[int],
) -> SeismometerUse:
    """The use with an accepted fit by the `chosen` signals; `names` are those of the components."""
    assert alone.ground is not None
    assert fit.ground is not None
    drive = fit.evidence.drive
    assert drive is not None
    assert drive.covariance is not None
    responses = []
    for component in sorted({column // SIGNALS for column in chosen}):
        first = chosen.index(component * SIGNALS)
        a, b = drive.gains[first], -drive.gains[first + 1]
        gain = hypot(a, b)
        covariance = drive.covariance[first : first + 2, first : first + 2] * np.array([[1, -1], [-1, 1]])
        along, across = np.array([a, b]) / gain, np.array([-b, a]) / gain
        responses.append(
            Response(
                name=names[component],
                gain=gain,
                u_gain=float(np.sqrt(along @ covariance @ along)),
                phase_rad=atan2(b, a),
                u_phase_rad=float(np.sqrt(across @ covariance @ across)) / gain,
                with_slope=columns_of(component, SLOPES)[0] in chosen,
            )
        )
    left = fit.ground.density_rad_per_s2_rthz
    explained_power = float(np.mean((drive.steps[0][~drive.missing] @ drive.gains) ** 2))
    step = fit.ground.noise.step
    return replace(
        use.with_saved(alone, fit),
        verdict=SeismometerVerdict.USED,
        explained=float(explained_power / (explained_power + step**2)),
        ground_left_rad_per_s2_rthz=left,
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
        The exact fit of these points without it, which is returned where predictions do not gain.
    averaged
        That of `fit_exact`.
    """
    search = _Search(points.first(alone.half_cycles), pendulum, alone, averaged)
    return search.with_corrected_clock(seismometer)


class _Selection(NamedTuple):
    """A fit with some of the seismometer's signals, and its gain of prediction by them."""

    fit: FitResult
    chosen: Sequence[int]
    gain: float


@dataclass(frozen=True)
class _Search:
    points: TurningPoints
    pendulum: PendulumOnBall
    alone: FitResult
    averaged: bool

    def with_corrected_clock(self, seismometer: Seismogram) -> SeismometerFit:
        """The fit with the seismometer, its clock corrected where the run shows an error of it.

        A slope of the phase is a delay. The clock is therefore corrected before slopes are fitted.
        """
        assert self.alone.ground is not None
        middle_s = 0.5 * float(self.points.time_s[0] + self.points.time_s[-1])
        delay_s = drift = 0.0
        for left in reversed(range(_MAX_CORRECTIONS + 1)):
            moved = seismometer.delayed(delay_s, drift, middle_s)
            try:
                drives = SignalDrives(self.points, moved, averaged=self.averaged)
            except DataError as error:
                return SeismometerFit(
                    self.alone, SeismometerUse(verdict=SeismometerVerdict.ABSENT, reason=str(error))
                )
            use = SeismometerUse(
                missing_half_cycles=int(np.count_nonzero(drives.every.missing)),
                ground_alone_rad_per_s2_rthz=self.alone.ground.density_rad_per_s2_rthz,
            )
            count = len(drives.every.missing)
            if use.missing_half_cycles > (1 - _MIN_COVERED_SHARE) * count:
                reason = f"{use.missing_half_cycles} of {count} half-swings have no seismometer"
                return SeismometerFit(
                    self.alone, replace(use, verdict=SeismometerVerdict.ABSENT, reason=reason)
                )
            found = self._with_signals(drives, _Selection(self.alone, [], 0.0), PAIR)
            if not found.chosen:
                return SeismometerFit(self.alone, replace(use, gain_of_prediction=found.gain))
            clock = clock_correction(self.points, self.pendulum, found.fit, drives, found.chosen)
            correction = ClockCorrection(
                Estimate(delay_s + clock.delay_s.value, clock.delay_s.standard_uncertainty),
                Estimate(drift + clock.drift.value, clock.drift.standard_uncertainty),
            )
            if not left or not clock.significant:
                break
            delay_s, drift = correction.delay_s.value, correction.drift.value
        found = self._with_signals(drives, found, SLOPES)
        u_delay_s = hypot(correction.delay_s.standard_uncertainty, _U_DELAY * drives.period_s)
        delay = Estimate(correction.delay_s.value, u_delay_s)
        use = replace(use, gain_of_prediction=found.gain, delay_s=delay, clock_drift=correction.drift)
        use = accepted_use(use, self.alone, found.fit, drives.names, found.chosen)
        return SeismometerFit(found.fit, use)

    def _with_signals(self, drives: SignalDrives, accepted: _Selection, kinds: tuple[int, ...]) -> _Selection:
        """The selection with further components whose signals of these kinds pay, the best one first.

        Slopes are added only to components in use. Where nothing is selected, the gain is that of the best.
        """
        used = sorted({column // SIGNALS for column in accepted.chosen})
        left = used if kinds is SLOPES else list(range(len(drives.names)))
        while left:
            gain = partial(
                gain_of_prediction, self.points, self.pendulum, accepted.fit, drives, accepted.chosen
            )
            gains = [gain(columns_of(component, kinds)) for component in left]
            best = int(np.argmax(gains))
            if not gains[best] > MIN_PREDICTION_GAIN:
                return accepted if accepted.chosen else accepted._replace(gain=gains[best])
            chosen = [*accepted.chosen, *columns_of(left.pop(best), kinds)]
            fit = self.fitted_with(accepted.fit, drives, chosen)
            accepted = _Selection(fit, chosen, accepted.gain + gains[best])
        return accepted

    def fitted_with(self, near: FitResult, drives: SignalDrives, chosen: Sequence[int]) -> FitResult:
        """The exact fit with some signals, started at an earlier fit with the first of them."""
        drive = with_start_gains(drives, near, chosen)
        return fit_exact(
            self.points,
            self.pendulum,
            law=self.alone.law,
            drag=self.alone.has_drag,
            evidence=replace(self.alone.evidence, drive=drive),
            loss=self.alone.loss,
            averaged=self.averaged,
            near=near,
        )
