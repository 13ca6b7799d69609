"""What a run will tell: standard uncertainties of a law's parameters before the run is made.

The turning points of a run follow from the law, their scatter from the measurement and the ground's drive.
The information that they hold (Fisher's matrix of the driven model) bounds every uncertainty from below, and
the fit comes near to this bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import hypot, inf
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import AMPLITUDE, DEFAULT_LAW, DRAG, TIME, Law, PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.checks import FEWEST_HALF_CYCLES
from processing.fit.evidence import Evidence, Waveform
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise, step_of_density
from processing.fit.result import FitResult
from processing.fit.witnessed_columns import LEAST_LEFT
from processing.least_squares import covariance_of
from processing.swing import HALVES, TurningPoints

_LOST = 10.0
"""A run ends where the ground moves the pendulum in a half-swing by more than the amplitude over this."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What makes turning points scatter: their measurement, and the drive.

    `u_time_amplitude_s_rad` is the product of a time's uncertainty and its amplitude; `averaged` is that of
    `Noise`. `of_sine` is the covariance in rad^2 of the harmonics in quadrature of a piece (see `Waveform`),
    None where they are not used, and `known_drag_s` what is known of the drag beside the run.
    `witness_noise` is that of a witness of the ground over what it sees of it, at the pendulum's frequency;
    None: there is none.
    """

    u_amplitude_rad: float
    u_time_amplitude_s_rad: float
    ground_rad_per_s2_rthz: float = 0.0
    averaged: bool = True
    of_sine: Floats | None = field(default=None, compare=False)
    known_drag_s: Estimate | None = None
    witness_noise: float | None = None

    @property
    def unknown_rad_per_s2_rthz(self) -> float:
        """What a witness with that noise, weighted as its noise asks, leaves of the drive."""
        if self.witness_noise is None:
            return self.ground_rad_per_s2_rthz
        return self.ground_rad_per_s2_rthz * self.witness_noise / hypot(1.0, self.witness_noise)

    @classmethod
    def of(cls, fit: FitResult, points: TurningPoints) -> "Conditions":
        """Those of a run that has been made; its drive is the likeliest one."""
        scale = 1.0 if fit.ground is None else fit.ground.noise.scale
        waveform = fit.evidence.waveform
        return cls(
            scale * float(np.median(points.u_amplitude)),
            scale * float(np.median(points.u_time_s * points.amplitude)),
            0.0 if fit.ground is None else fit.ground.density_rad_per_s2_rthz.value,
            of_sine=None if waveform is None else np.median(waveform.covariance, axis=0),
            known_drag_s=fit.evidence.drag_s,
        )

    def evidence(self, amplitude_rad: Floats) -> Evidence:
        """What a run through turning points of these amplitudes is restrained by; its values are nought."""
        if self.of_sine is None:
            return Evidence(drag_s=self.known_drag_s)
        middle = amplitude_rad[HALVES // 2 :: HALVES]
        covariance = np.tile(self.of_sine, (len(middle), 1, 1))
        nothing = np.zeros((len(middle), len(self.of_sine)))
        return Evidence(Waveform(middle, nothing, covariance, 1.0), self.known_drag_s)

    def on_ground(self, rad_per_s2_rthz: float) -> "Conditions":
        """The same measurement on another ground; the noise of a witness stays what it is, not its ratio."""
        noise = self.witness_noise
        if noise is not None and rad_per_s2_rthz > 0:
            noise = max(LEAST_LEFT, noise * self.ground_rad_per_s2_rthz / rad_per_s2_rthz)
        return replace(self, ground_rad_per_s2_rthz=rad_per_s2_rthz, witness_noise=noise)

    def with_witness(self, noise: float) -> "Conditions":
        """The same ground, seen by a witness as well."""
        return replace(self, witness_noise=noise)


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run between two amplitudes: how long it lasts, and the uncertainty of every parameter after it.

    `complete` is False where the drive drowns the pendulum before the amplitude at which it should end.
    """

    first_rad: float
    last_rad: float
    duration_s: float
    half_cycles: int
    u: Mapping[str, float]
    complete: bool = True


def planned_run(
    values: Mapping[str, float],
    pendulum: PendulumOnBall | None,
    conditions: Conditions,
    first_rad: float,
    last_rad: float,
    *,
    law: Law = DEFAULT_LAW,
) -> PlannedRun:
    """What a run from one amplitude to another will tell of a law with these values.

    Raises
    ------
    DataError
        The pendulum makes too few half-cycles between the two amplitudes, or none ends there.
    """
    prepared = prepare_run(values, pendulum, conditions, first_rad, last_rad, law=law)
    model, columns = prepared.model, prepared.columns
    jacobian = model.about(columns).on_ground(columns, prepared.noise)(columns)[1]
    to_physical = model.columns.physical(columns)[1]
    u = np.sqrt(np.diag(to_physical @ covariance_of(jacobian) @ to_physical.T))
    return prepared.run(dict(zip(model.names[:-2], u.tolist(), strict=False)))


class PreparedRun(NamedTuple):
    """The model of a planned run about its parameters, and the ground under it."""

    model: ExactModel
    columns: Floats
    noise: Noise
    first_rad: float
    last_rad: float
    complete: bool

    @property
    def duration_s(self) -> float:
        """From the first turning point to the last."""
        return float(self.model.points.time_s[-1])

    def run(self, u: Mapping[str, float]) -> PlannedRun:
        """With these uncertainties."""
        points = self.model.points
        return PlannedRun(self.first_rad, self.last_rad, self.duration_s, len(points), u, self.complete)


def prepare_run(
    values: Mapping[str, float],
    pendulum: PendulumOnBall | None,
    conditions: Conditions,
    first_rad: float,
    last_rad: float,
    *,
    law: Law = DEFAULT_LAW,
) -> PreparedRun:
    """A run from one amplitude to another, with what restrains its fit; raises as `planned_run` does."""
    names = law.fit_names(calibrated=pendulum is not None, drag=DRAG.key in values)
    known = {**values, AMPLITUDE.key: first_rad, TIME.key: 0.0}
    amplitude, time, complete = _decay(law, known, names, pendulum, first_rad, last_rad, conditions)
    if len(amplitude) < FEWEST_HALF_CYCLES:
        raise DataError(
            f"from {first_rad:.3g} to {last_rad:.3g} rad there are {len(amplitude)} half-cycles; a fit needs "
            f"{FEWEST_HALF_CYCLES}"
        )
    points = TurningPoints(
        np.arange(len(amplitude), dtype=np.int64),
        time,
        conditions.u_time_amplitude_s_rad / amplitude,
        amplitude,
        np.full(len(amplitude), conditions.u_amplitude_rad),
    )
    evidence = conditions.evidence(amplitude)
    model = ExactModel(points, pendulum, law=law, drag=DRAG.key in values, evidence=evidence)
    half_period_s = float(np.diff(time).mean())
    step = step_of_density(conditions.unknown_rad_per_s2_rthz, half_period_s) / model.reference
    noise = Noise(step=step, averaged=conditions.averaged)
    return PreparedRun(model, model.columns.from_physical(known), noise, first_rad, last_rad, complete)


def _decay(
    law: Law,
    known: Mapping[str, float],
    names: tuple[str, ...],
    pendulum: PendulumOnBall | None,
    first_rad: float,
    last_rad: float,
    conditions: Conditions,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Amplitudes and times of the law's free decay, and whether it reaches the last amplitude."""
    scaled = TurningPoints(
        np.array([0, 1], dtype=np.int64),
        np.array([0.0, 1.0]),
        np.ones(2),
        np.array([first_rad, last_rad]),
        np.full(2, 1e-3 * last_rad),
    )
    columns = law.columns(scaled, pendulum, names)
    parameters = columns.map_parameters(columns.from_physical(known))[0]
    count = 256
    while True:
        found = law.half_swing_map(parameters[:-2], np.arange(count, dtype=np.int64))
        amplitude = found.amplitude * columns.reference
        if not np.isfinite(amplitude[-1]) or amplitude[-1] < last_rad or count > 1 << 16:
            break
        count *= 2
    time = found.time * parameters[-2]
    half_period_s = float(time[1]) if np.isfinite(time[1]) else inf
    weakest = _LOST * step_of_density(conditions.ground_rad_per_s2_rthz, half_period_s)
    lasting = np.isfinite(amplitude) & (amplitude >= max(last_rad, weakest))
    complete = bool(weakest <= last_rad and np.nanmin(amplitude) < last_rad)
    return amplitude[lasting], time[lasting], complete
