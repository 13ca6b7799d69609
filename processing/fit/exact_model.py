"""A law's half-swing map as a least-squares model of amplitudes and times, at rest or on moving ground."""

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
"""Times the measured half-cycles after which a law's free decay is followed no further."""
_STEP = 3.0
"""Step of a derivative of the evidence, in uncertainties of one column while the others are known."""
_SHORTER, _SHORTENINGS = 0.25, 12
"""Part of a step that is tried next where it was too long, and the most parts that are tried."""


class _LinearEvidence(NamedTuple):
    """Residuals of the evidence, linear about the columns `at`.

    `scale` is the factor by which turning points scatter more than stated.
    """

    at: Floats
    residuals: Floats
    jacobian: Floats
    scale: float = 1.0

    def __call__(self, columns: Floats) -> tuple[Floats, Floats]:
        jacobian = self.scale * self.jacobian
        return self.scale * self.residuals + jacobian @ (columns - self.at), jacobian


class DiscrepancyColumns(NamedTuple):
    """Relative errors that a law may have, one a column, as functions of the nodes of a half-swing.

    Each takes falling amplitudes in units of the reference and the times in s at which a free decay passes
    them, counted from the first turning point, and returns an array (nodes, m) of relative changes.
    """

    of_loss: Callable[[Floats, Floats], Floats]
    of_duration: Callable[[Floats, Floats], Floats]


class FilterResult(NamedTuple):
    """Whitened innovations, their Jacobian of the columns at fixed gains, and more of `drive_filter`."""

    residuals: Floats
    jacobian: Floats
    log_det: float
    gains: Floats


class ExactModel:
    """Residuals and Jacobian of the joint fit, for the solver's columns of a law.

    On ground at rest all turning points lie on one free decay, and the residuals are their distances from
    it in standard uncertainties. Where the ground moves (`on_ground`) they are the whitened innovations
    of a Kalman filter: each turning point against the prediction from those before it. Steps are in
    units of `reference`.

    Residuals of the `evidence` follow those of the amplitudes and times. They are linear about the columns of
    the last `linearised_at`, and are multiplied by `scale`, so that they scatter as the turning points do.

    Raises
    ------
    DataError
        The law cannot be fitted with a drag, or to these points.
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
        self.columns = law.coordinates(points, pendulum, self.names, gains)
        self.lower, self.upper = self.columns.lower, self.columns.upper
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

    def curve(self, columns: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Amplitude (in units of the reference), time (s), and the derivatives of both with respect to the
        columns.

        With the columns v, the map's parameters q(v) and its time tau in units of T0:
        ``t = t_0 + T0 tau``, ``dt/dv = T0 dtau/dq dq/dv + tau dT0/dv + dt_0/dv``.
        """
        parameters, matrix = self.columns.map_parameters(columns)
        if not np.all(np.isfinite(parameters)):
            nothing = np.full((len(self._x), len(columns)), np.nan)
            return nothing[:, 0], nothing[:, 0], nothing, nothing
        period0_s, first_time_s = parameters[-2:]
        found = self._swings.at_the_points(parameters[:-2])
        amplitude_jacobian = found.amplitude_gradient @ matrix[:-2]
        time_jacobian = period0_s * (found.time_gradient @ matrix[:-2])
        time_jacobian += found.time[:, None] * matrix[-2] + matrix[-1]
        return found.amplitude, first_time_s + period0_s * found.time, amplitude_jacobian, time_jacobian

    def __call__(self, columns: Floats) -> tuple[Floats, Floats]:
        """Residuals over their standard uncertainties, and their derivatives with respect to the columns."""
        residuals, jacobian = self._point_residuals(columns)
        if not len(self._evidence_rows.residuals):
            return residuals, jacobian
        beside = self._evidence_rows(columns)
        return np.concatenate([residuals, beside[0]]), np.concatenate([jacobian, beside[1]])

    @property
    def scale(self) -> float:
        """The factor by which the turning points scatter more than stated, as given to `on_ground`."""
        return self._evidence_rows.scale

    def evidence_rows(self, columns: Floats) -> tuple[Floats, Floats]:
        """Residuals of the evidence, in units of their scatter, and their Jacobian of the columns."""
        return self._evidence_rows._replace(scale=1.0)(columns)

    def _point_residuals(self, columns: Floats) -> tuple[Floats, Floats]:
        if self._gains is not None:
            found = self.filtered(columns, self._noise, self._gains)
            return found.residuals, found.jacobian
        amplitude, time, amplitude_jacobian, time_jacobian = self.curve(columns)
        u = np.concatenate([self.u_amplitude, self.points.u_time_s])
        residuals = (np.concatenate([amplitude, time]) - self._measured.ravel()) / u
        return residuals, np.concatenate([amplitude_jacobian, time_jacobian]) / u[:, None]

    def on_ground(self, columns: Floats, noise: Noise, scale: float = 1.0) -> "ExactModel":
        """The same model with residuals that allow for the drive, weighted as the filter does at `columns`.

        The weights stay: the residuals then depend on the columns by the predictions alone, so that a minimum
        of their squares is where the predictions are best, and not where the weights are smallest. `scale` is
        the factor by which turning points scatter more than stated, where `noise` does not contain that.
        """
        out = copy(self)
        out._noise = noise
        # a known drive moves the state of the filter even without an unknown one, and so does a knock
        free = noise == AT_REST and self.known_drive is None and not self._knocked.any()
        out._gains = None if free else self.filtered(columns, noise).gains
        out._evidence_rows = self._evidence_rows._replace(scale=scale)
        return out

    def linearised_at(self, columns: Floats) -> "ExactModel":
        """The same model with the residuals of the evidence linearised at these columns.

        Raises DataError if the law predicts no waveform there.
        """
        out = copy(self)
        here = self.evidence_residuals(columns)
        jacobian = np.zeros((len(here), len(columns)))
        if len(here):
            # steps of some uncertainties of each column by the points if the others are known
            size = np.linalg.norm(self._point_residuals(columns)[1], axis=0)
            steps = _STEP / np.where(size > 0.0, size, np.inf)
            # the first amplitude and time are none of the law's parameters
            of_law = self.columns.physical(columns)[1][:-2].any(axis=0) & (steps > 0.0)
            for column in np.flatnonzero(of_law).tolist():
                along = np.eye(len(columns))[column]
                jacobian[:, column] = self._evidence_slope(columns, here, float(steps[column]) * along)
        out._evidence_rows = _LinearEvidence(columns.copy(), here, jacobian, self._evidence_rows.scale)
        return out

    def _evidence_slope(self, columns: Floats, here: Floats, step: Floats) -> Floats:
        """Change of the evidence's residuals per length of a step, which is shortened where it is too long.

        On ground that shakes, the evidence may know a column far better than the points do: a step of their
        uncertainty would leave the range in which the evidence is linear, or in which the pendulum swings.
        """
        for part in _SHORTER ** np.arange(_SHORTENINGS):
            for way in (part, -part):
                # at the end of a parameter's range there is a value on one side alone
                with suppress(DataError):
                    change = self.evidence_residuals(columns + way * step) - here
                    if np.linalg.norm(change) <= _STEP:
                        return np.asarray(change / (way * np.linalg.norm(step)))
                    break
        raise DataError("the waveform of the swing changes at once where the law's parameters change least")

    def evidence_at(self, columns: Floats, covariance: Floats) -> Evidence:
        """The evidence, its known drive with the fitted gains if there is one."""
        if self.known_drive is None or self.evidence.drive is None:
            return self.evidence
        found = self.known_drive.gains(columns, covariance)
        return replace(self.evidence, drive=self.evidence.drive.with_gains(*found))

    def evidence_residuals(self, columns: Floats, more: Mapping[str, float] = MappingProxyType({})) -> Floats:
        """Residuals of the evidence by the law itself, not linearised, with further values of the waveform.

        Raises DataError if the law predicts no waveform.
        """
        if self.evidence == NO_EVIDENCE:
            return np.zeros(0)
        return self.evidence.residuals(self.law, {**self.values(columns), **more}, self.pendulum)

    def filtered(
        self,
        columns: Floats,
        noise: Noise,
        gains: Floats | None = None,
        *,
        with_rho: bool = False,
        errors: DiscrepancyColumns | None = None,
    ) -> FilterResult:
        """The Kalman filter over the half-cycles; with `gains` of an earlier call it uses these.

        `with_rho` adds a column to the Jacobian, the derivatives with respect to ln(R/a), and `errors` one
        for each relative error, those of the losses first.
        """
        parameters, matrix = self.columns.map_parameters(columns)
        if with_rho:
            by_rho = np.concatenate([self.columns.map_by_log_rho, [0.0, 0.0]])
            matrix = np.column_stack([matrix, by_rho])
        count, held = len(self._x), gains is not None
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
            self._known_steps(columns, loss_by.shape[1]),
            gains,
            held,
            noise.limit,
        )
        return FilterResult(innovations.ravel(), jacobian.reshape(2 * count, -1), log_det, gains)

    def _known_steps(self, columns: Floats, width: int) -> KnownSteps:
        """What is known of the drive, and the half-swings of knocks, for a Jacobian of `width` columns."""
        if self.known_drive is not None:
            return self.known_drive.known(columns, width)._replace(knocked=self._knocked)
        if not self._knocked.any():
            return NOTHING_KNOWN
        count = len(self._knocked)
        return KnownSteps(np.zeros((2, count)), np.zeros((2, count, width)), np.zeros(count), self._knocked)

    def values(self, columns: Floats) -> dict[str, float]:
        """Values of the law's parameters by their names."""
        return dict(zip(self.names, self.columns.physical(columns)[0].tolist(), strict=True))

    def losses(self, columns: Floats) -> tuple[Floats, Floats]:
        """Falling amplitudes through the decay, and the loss of a half-swing from each, in units of the
        reference.

        Raises DataError where the law's pendulum stops earlier.
        """
        table = self._swings.through_the_decay(self.columns.map_parameters(columns)[0])
        if table is None:
            raise DataError("the pendulum would not swing for as long as it did")
        return table.amplitude, table.loss

    def by_log_rho(self, columns: Floats) -> Floats:
        """Derivatives of the columns, which were fitted with the weights of this model, by ln(R/a)."""
        of_points = self.filtered(columns, self._noise, self._gains, with_rho=True).jacobian
        by_evidence = self._evidence_rows(columns)[1]
        both = np.concatenate([of_points, np.pad(by_evidence, ((0, 0), (0, 1)))])
        return -FactoredJacobian(both[:, :-1]).coefficients(both[:, -1])

    def with_larger_measurements(self, amplitude: Floats, time_s: Floats) -> "ExactModel":
        """The same model with larger measured amplitudes (in units of the reference) and times (s)."""
        out = copy(self)
        out._measured = self._measured + np.array([amplitude, time_s])
        return out

    @classmethod
    def of(
        cls, points: TurningPoints, pendulum: PendulumOnBall, result: FitResult
    ) -> tuple["ExactModel", Floats]:
        """The model of a finished exact fit of these points with its noise, and the fitted columns."""
        model = cls(
            points.first(result.half_cycles),
            pendulum,
            law=result.law,
            drag=result.has_drag,
            evidence=result.evidence,
        )
        columns = model.columns.from_physical(result.named_values)
        scale = 1.0 if result.ground is None else result.ground.measurement_scale
        return model.on_ground(columns, model.noise_of(result), scale).linearised_at(columns), columns

    def noise_of(self, result: FitResult) -> Noise:
        """The noise by which a finished fit of the same points weighted its residuals."""
        if result.ground is None or result.ground.noise.at_rest:
            return AT_REST
        noise = result.ground.noise.in_stated_uncertainties
        return replace(noise, step=noise.step / self.reference)


class LawHalfSwings:
    """Half-swings of a law for the half-cycles `index`, of measured amplitudes `x` in units of the reference.

    The last ones are cached, for all copies of a model: a search often begins where another one ended.
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
            swings = self._from(parameters, float(parameters[-1]), int(self._index[-1]))
            self._at_points.clear()
            self._at_points[key] = swings.turning_points(float(parameters[-1]), self._index)
        return self._at_points[key]

    def through_the_decay(self, parameters: Floats) -> HalfCycleLosses | None:
        """One half-swing at all amplitudes of the data; None if these parameters have none."""
        if not np.all(np.isfinite(parameters)):
            return None
        key = parameters[:-3].tobytes()
        if key not in self._in_decay:
            count = _DECAY_LENGTH_FACTOR * int(self._index[-1])
            self._in_decay.clear()
            self._in_decay[key] = self._from(parameters[:-2], self._highest, count, self._lowest)
        swings = self._in_decay[key]
        return swings if len(swings.amplitude) > 1 else None

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
