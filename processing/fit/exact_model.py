"""A law's map of half-cycles as a least-squares model of amplitudes and times, also on moving ground."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import copy
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.contact import (
    TABLE_RATIO,
    HalfCycleLosses,
    HalfCycleTable,
    PendulumOnBall,
    PredictedTurningPoints,
    iterate_decay,
)
from processing.contact.laws import DEFAULT_LAW, Law
from processing.decay_summary import mean_period, reference_amplitude
from processing.errors import DataError
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.ground import (
    AT_REST,
    GAINS,
    NOTHING_KNOWN,
    KnownSteps,
    MeasuredTurningPoints,
    Noise,
    Predictions,
    drive_filter,
)
from processing.fit.known_drive import DriveGains
from processing.fit.result import FitResult
from processing.least_squares import FactoredJacobian
from processing.swing import TurningPoints

_ABOVE, _BELOW = 1.05, 0.6
"""Highest and lowest amplitude of the tabulated half-swings, over the highest and lowest measured one."""
_DECAY_LENGTH_FACTOR = 4
"""A law's free decay is followed over this many times the measured half-cycles."""
_STEP_U = 3.0
"""Step of a derivative of the evidence, in uncertainties of one coordinate while the others are known."""
_SHORTENING, _MAX_SHORTENINGS = 0.25, 12
"""Factor by which a step that is too long is shortened, and how often at most."""


class _LinearEvidence(NamedTuple):
    """Residuals of the evidence, linear about the coordinates `origin`."""

    origin: Floats
    residuals: Floats
    jacobian: Floats
    scale: float = 1.0
    """Factor by which turning points scatter more than stated."""

    def __call__(self, coordinates: Floats) -> tuple[Floats, Floats]:
        jacobian = self.scale * self.jacobian
        return self.scale * self.residuals + jacobian @ (coordinates - self.origin), jacobian


class DiscrepancyColumns(NamedTuple):
    """Relative errors that a law may have, one a column, of its losses and of its durations.

    Both functions take falling amplitudes (nodes,) in units of the reference, and the times (nodes,) in s at
    which a free decay passes them, counted from the first turning point. They return relative changes
    (nodes, m).
    """

    of_loss: Callable[[Floats, Floats], Floats]
    of_duration: Callable[[Floats, Floats], Floats]


class FilterResult(NamedTuple):
    """Whitened innovations, their derivatives by the coordinates at fixed gains, and ln det and gains of
    `drive_filter`."""

    residuals: Floats
    jacobian: Floats
    log_det: float
    gains: Floats


class ExactModel:
    """Residuals and Jacobian of the joint fit, as functions of the solver's coordinates.

    On ground at rest all turning points lie on one free decay, and the residuals are their distances from
    it in standard uncertainties. Where the ground moves (`on_ground`) they are the whitened innovations
    of a Kalman filter: each turning point against the prediction from those before it. Steps are in
    units of `reference`.

    Residuals of the `evidence` follow those of amplitudes and times. They are linear about the coordinates
    of the last `linearised_at`, and are multiplied by `scale`, so that they scatter as the turning points do.

    Raises DataError where the law cannot be fitted with a drag, or to these points.
    """

    def __init__(
        self,
        points: TurningPoints,
        pendulum: PendulumOnBall,
        *,
        law: Law = DEFAULT_LAW,
        drag: bool = False,
        evidence: Evidence = NO_EVIDENCE,
    ) -> None:
        self.points = points
        self.pendulum = pendulum
        self.law = law
        self.evidence = evidence
        self.names = law.fit_names(drag=drag)
        self.reference = reference_amplitude(points)
        self.known_drive = None if evidence.drive is None else DriveGains(evidence.drive, self.reference)
        gains = () if self.known_drive is None else self.known_drive.start
        self.parametrisation = law.coordinates(points, pendulum, self.names, gains)
        self.lower, self.upper = self.parametrisation.lower, self.parametrisation.upper
        self._index = np.ascontiguousarray(points.index - points.index[0])
        self._x = points.amplitude / self.reference
        self._knocked = np.zeros(int(self._index[-1]) + 1, dtype=np.bool_)
        self._knocked[self._index[np.isin(points.index, evidence.knocks)]] = True
        self.u_amplitude = points.u_amplitude / self.reference
        self.lowest = float(self._x.min())
        self._rate = 2 * np.pi / mean_period(points)
        self._measured = np.array([self._x, points.time_s])
        self._variance = np.array([self.u_amplitude, points.u_time_s]) ** 2
        self._noise = AT_REST
        self._gains: Floats | None = None
        count = len(self.lower)
        self._evidence_rows = _LinearEvidence(np.zeros(count), np.zeros(0), np.zeros((0, count)))
        self._swings = LawHalfSwings(law, self._index, self._x)

    def curve(self, coordinates: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Amplitude (in units of the reference), time (s), and their derivatives by the coordinates.

        With the coordinates v, the map's parameters q(v) and its time tau in units of T0:
        ``t = t_0 + T0 tau``, ``dt/dv = T0 dtau/dq dq/dv + tau dT0/dv + dt_0/dv``.
        """
        parameters, matrix = self.parametrisation.map_parameters(coordinates)
        if not np.all(np.isfinite(parameters)):
            nothing = np.full((len(self._x), len(coordinates)), np.nan)
            return nothing[:, 0], nothing[:, 0], nothing, nothing
        period0_s, first_time_s = parameters[-2:]
        decay = self._swings.at_the_points(parameters[:-2])
        amplitude_jacobian = decay.amplitude_gradient @ matrix[:-2]
        time_jacobian = period0_s * (decay.time_gradient @ matrix[:-2])
        time_jacobian += decay.time[:, None] * matrix[-2] + matrix[-1]
        return decay.amplitude, first_time_s + period0_s * decay.time, amplitude_jacobian, time_jacobian

    def __call__(self, coordinates: Floats) -> tuple[Floats, Floats]:
        """Residuals over their standard uncertainties, and their derivatives by the coordinates."""
        residuals, jacobian = self._point_residuals(coordinates)
        if not len(self._evidence_rows.residuals):
            return residuals, jacobian
        evidence, by_evidence = self._evidence_rows(coordinates)
        return np.concatenate([residuals, evidence]), np.concatenate([jacobian, by_evidence])

    @property
    def scale(self) -> float:
        """The factor by which the turning points scatter more than stated, as given to `on_ground`."""
        return self._evidence_rows.scale

    def evidence_rows(self, coordinates: Floats) -> tuple[Floats, Floats]:
        """Residuals of the evidence, in units of their scatter, and their Jacobian of the coordinates."""
        return self._evidence_rows._replace(scale=1.0)(coordinates)

    def _point_residuals(self, coordinates: Floats) -> tuple[Floats, Floats]:
        if self._gains is not None:
            filtered = self.filtered(coordinates, self._noise, self._gains)
            return filtered.residuals, filtered.jacobian
        amplitude, time, amplitude_jacobian, time_jacobian = self.curve(coordinates)
        u = np.concatenate([self.u_amplitude, self.points.u_time_s])
        residuals = (np.concatenate([amplitude, time]) - self._measured.ravel()) / u
        return residuals, np.concatenate([amplitude_jacobian, time_jacobian]) / u[:, None]

    def on_ground(self, coordinates: Floats, noise: Noise, scale: float = 1.0) -> "ExactModel":
        """The same model with residuals that allow for the drive, with the filter's weights at `coordinates`.

        The weights stay: the residuals then depend on the coordinates by the predictions alone, so that a
        minimum of their squares is where the predictions are best, and not where the weights are smallest.
        `scale` is the factor by which turning points scatter more than stated, where `noise` does not contain
        that.
        """
        model = copy(self)
        model._noise = noise
        # a known drive moves the state of the filter even without an unknown one, and so does a knock
        is_free = noise == AT_REST and self.known_drive is None and not self._knocked.any()
        model._gains = None if is_free else self.filtered(coordinates, noise).gains
        model._evidence_rows = self._evidence_rows._replace(scale=scale)
        return model

    def linearised_at(self, coordinates: Floats) -> "ExactModel":
        """The same model with the evidence linearised here; raises DataError if the law has no waveform."""
        model = copy(self)
        residuals = self.evidence_residuals(coordinates)
        jacobian = np.zeros((len(residuals), len(coordinates)))
        if len(residuals):
            # uncertainties of each coordinate by the points if the others are known
            size = np.linalg.norm(self._point_residuals(coordinates)[1], axis=0)
            steps = _STEP_U / np.where(size > 0.0, size, np.inf)
            # the first amplitude and time are none of the law's parameters
            of_law = self.parametrisation.physical(coordinates)[1][:-2].any(axis=0) & (steps > 0.0)
            for place in np.flatnonzero(of_law).tolist():
                step = float(steps[place]) * np.eye(len(coordinates))[place]
                jacobian[:, place] = self._evidence_slope(coordinates, residuals, step)
        scale = self._evidence_rows.scale
        model._evidence_rows = _LinearEvidence(coordinates.copy(), residuals, jacobian, scale)
        return model

    def _evidence_slope(self, coordinates: Floats, residuals: Floats, step: Floats) -> Floats:
        """Change of the evidence's residuals per length of a step, which is shortened where the evidence
        knows the coordinate far better than the points do, whose uncertainty the step is."""
        for share in _SHORTENING ** np.arange(_MAX_SHORTENINGS):
            for factor in (share, -share):
                # at the end of a parameter's range there is a value on one side alone
                with suppress(DataError):
                    change = self.evidence_residuals(coordinates + factor * step) - residuals
                    if np.linalg.norm(change) <= _STEP_U:
                        return np.asarray(change / (factor * np.linalg.norm(step)))
                    break
        raise DataError("the waveform of the swing changes at once where the law's parameters change least")

    def evidence_at(self, coordinates: Floats, covariance: Floats) -> Evidence:
        """The evidence, its known drive with the fitted gains if there is one."""
        if self.known_drive is None or self.evidence.drive is None:
            return self.evidence
        drive = self.evidence.drive.with_gains(*self.known_drive.gains(coordinates, covariance))
        return replace(self.evidence, drive=drive)

    def evidence_residuals(
        self, coordinates: Floats, further: Mapping[str, float] = MappingProxyType({})
    ) -> Floats:
        """Residuals of the evidence by the law itself, not linearised, with further values of the waveform;
        raises DataError if the law predicts no waveform."""
        if self.evidence == NO_EVIDENCE:
            return np.zeros(0)
        return self.evidence.residuals(self.law, {**self.values(coordinates), **further}, self.pendulum)

    def filtered(
        self,
        coordinates: Floats,
        noise: Noise,
        gains: Floats | None = None,
        *,
        with_rho: bool = False,
        errors: DiscrepancyColumns | None = None,
    ) -> FilterResult:
        """The Kalman filter over the half-cycles, with the `gains` of an earlier call or with its own.

        `with_rho` adds a column to the Jacobian, the derivatives with respect to ln(R/a), and `errors` one
        for each relative error, those of the losses first.
        """
        parameters, matrix = self.parametrisation.map_parameters(coordinates)
        if with_rho:
            by_rho = np.concatenate([self.parametrisation.map_by_log_rho, [0.0, 0.0]])
            matrix = np.column_stack([matrix, by_rho])
        count, is_held = len(self._x), gains is not None
        gains = np.zeros((count, GAINS)) if gains is None else gains
        table = self._swings.through_the_decay(parameters)
        if table is None:
            nothing = np.full((2 * count, matrix.shape[1]), np.nan)
            return FilterResult(nothing[:, 0], nothing, np.nan, gains)
        period0_s = parameters[-2]
        of_map = np.ascontiguousarray(matrix[:-2])
        loss_by = table.loss_gradient @ of_map
        duration_by = period0_s * (table.duration_gradient @ of_map) + table.duration[:, None] * matrix[-2]
        start_by = matrix[[-3, -1]]
        if errors is not None:
            ends_s = period0_s * np.cumsum(table.duration)
            ends_s -= np.interp(-self._x[0], -table.amplitude, ends_s)
            of_loss = table.loss[:, None] * errors.of_loss(table.amplitude, ends_s)
            of_duration = period0_s * table.duration[:, None] * errors.of_duration(table.amplitude, ends_s)
            loss_by = np.column_stack([loss_by, of_loss, np.zeros_like(of_duration)])
            duration_by = np.column_stack([duration_by, np.zeros_like(of_loss), of_duration])
            start_by = np.column_stack([start_by, np.zeros((2, loss_by.shape[1] - matrix.shape[1]))])
        nodes = np.array(
            [
                table.amplitude, table.loss, table.loss_slope,
                period0_s * table.duration, period0_s * table.duration_slope,
            ]
        )  # fmt: skip
        variance = self._variance * noise.scale**2
        innovations, jacobian, log_det = drive_filter(
            Predictions(nodes, loss_by, duration_by, parameters[[-3, -1]], start_by),
            MeasuredTurningPoints(self._index, self._measured, variance, self._rate, noise.averaged),
            noise.step,
            self._known_steps(coordinates, loss_by.shape[1]),
            gains,
            is_held,
            noise.limit,
        )
        return FilterResult(innovations.ravel(), jacobian.reshape(2 * count, -1), log_det, gains)

    def _known_steps(self, coordinates: Floats, width: int) -> KnownSteps:
        """The known part of the drive, and the half-swings of knocks, for a Jacobian of `width` columns."""
        if self.known_drive is not None:
            return self.known_drive.known(coordinates, width)._replace(knocked=self._knocked)
        if not self._knocked.any():
            return NOTHING_KNOWN
        count = len(self._knocked)
        return KnownSteps(np.zeros((2, count)), np.zeros((2, count, width)), np.zeros(count), self._knocked)

    def values(self, coordinates: Floats) -> dict[str, float]:
        """Values of the law's parameters by their names."""
        return dict(zip(self.names, self.parametrisation.physical(coordinates)[0].tolist(), strict=True))

    def losses(self, coordinates: Floats) -> tuple[Floats, Floats]:
        """Falling amplitudes through the decay, and the loss in a half-swing from each, in units of the
        reference; raises DataError where the law's pendulum stops earlier."""
        table = self._swings.through_the_decay(self.parametrisation.map_parameters(coordinates)[0])
        if table is None:
            raise DataError("the pendulum would not swing for as long as it did")
        return table.amplitude, table.loss

    def by_log_rho(self, coordinates: Floats) -> Floats:
        """Derivatives of the coordinates, which were fitted with the weights of this model, by ln(R/a)."""
        of_points = self.filtered(coordinates, self._noise, self._gains, with_rho=True).jacobian
        by_evidence = self._evidence_rows(coordinates)[1]
        rows = np.concatenate([of_points, np.pad(by_evidence, ((0, 0), (0, 1)))])
        return -FactoredJacobian(rows[:, :-1]).coefficients(rows[:, -1])

    def with_larger_measurements(self, amplitude: Floats, time_s: Floats) -> "ExactModel":
        """The same model with larger measured amplitudes (in units of the reference) and times (s)."""
        model = copy(self)
        model._measured = self._measured + np.array([amplitude, time_s])
        return model

    @classmethod
    def of(
        cls, points: TurningPoints, pendulum: PendulumOnBall, result: FitResult
    ) -> tuple["ExactModel", Floats]:
        """The model of a finished exact fit of these points with its noise, and the fitted coordinates."""
        model = cls(
            points.first(result.half_cycles),
            pendulum,
            law=result.law,
            drag=result.has_drag,
            evidence=result.evidence,
        )
        coordinates = model.parametrisation.from_physical(result.named_values)
        scale = result.ground_fit.measurement_scale
        weighted = model.on_ground(coordinates, model.noise_of(result), scale)
        return weighted.linearised_at(coordinates), coordinates

    def noise_of(self, result: FitResult) -> Noise:
        """The noise by which a finished fit of the same points weighted its residuals."""
        noise = result.ground_fit.noise.as_weights
        return replace(noise, step=noise.step / self.reference)


class LawHalfSwings:
    """Half-swings of a law for the half-cycles `index`, of measured amplitudes `x` in units of the reference.

    Those of the last parameters are cached, for all copies of a model: a search often begins where another
    one ended.
    """

    def __init__(self, law: Law, index: NDArray[np.int64], x: Floats) -> None:
        self._law, self._index = law, index
        self._highest, self._lowest = _ABOVE * float(x.max()), _BELOW * float(x.min())
        self._table: dict[bytes, HalfCycleTable | None] = {}
        self._in_decay: dict[bytes, HalfCycleLosses] = {}
        self._at_points: dict[bytes, PredictedTurningPoints] = {}

    def at_the_points(self, parameters: Floats) -> PredictedTurningPoints:
        """Turning points at the indices of the points."""
        key = parameters.tobytes()
        if key not in self._at_points:
            decay = self._from(parameters, float(parameters[-1]), int(self._index[-1]))
            self._at_points.clear()
            self._at_points[key] = decay.turning_points(float(parameters[-1]), self._index)
        return self._at_points[key]

    def through_the_decay(self, parameters: Floats) -> HalfCycleLosses | None:
        """Half-cycles at all amplitudes of the data; None if the law has no decay with these parameters."""
        if not np.all(np.isfinite(parameters)):
            return None
        key = parameters[:-3].tobytes()
        if key not in self._in_decay:
            count = _DECAY_LENGTH_FACTOR * int(self._index[-1])
            self._in_decay.clear()
            self._in_decay[key] = self._from(parameters[:-2], self._highest, count, self._lowest)
        decay = self._in_decay[key]
        return decay if len(decay.amplitude) > 1 else None

    def _from(self, parameters: Floats, first: float, count: int, lowest: float = 0.0) -> HalfCycleLosses:
        """The free decay from a first to a lowest amplitude, by one table for all amplitudes of the data."""
        own = parameters[:-1]
        key = own.tobytes()
        if key not in self._table:
            self._table.clear()
            self._table[key] = self._law.table(own, self._highest, self._lowest)
        table = self._table[key]

        def table_from(amplitude: float) -> HalfCycleTable | None:
            if table is not None and table.holds(amplitude):
                return table
            return self._law.table(own, amplitude, amplitude / TABLE_RATIO) if amplitude > lowest else None

        return iterate_decay(table_from, len(parameters), first, count)
