"""Planned runs: standard uncertainties of a law's parameters before a run is made.

The turning points of a run follow from the law, their scatter from the measurement and the ground's drive.
The information that they hold (Fisher's matrix of the driven model) bounds every uncertainty from below, and
the fit comes near to this bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import hypot, inf, sqrt

import numpy as np

from processing.arrays import Floats
from processing.contact import AMPLITUDE, DEFAULT_LAW, DRAG, TIME, PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import Evidence, Waveform
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import FEWEST_HALF_CYCLES
from processing.fit.ground import Noise, step_of_density
from processing.fit.known_drive import LEAST_UNEXPLAINED
from processing.fit.result import FitResult
from processing.fit.terms import DrivenRows
from processing.least_squares import covariance_of
from processing.swing import PIECE_HALF_CYCLES, TurningPoints

_HIDDEN_RATIO = 10.0
"""A run ends where the amplitude is this many times the ground's step in a half-swing."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions that make turning points scatter: their measurement, and the drive."""

    u_amplitude_rad: float
    u_time_amplitude_s_rad: float
    """Product of a time's uncertainty and its amplitude."""
    ground_rad_per_s2_rthz: float = 0.0
    sine_covariance: Floats | None = field(default=None, compare=False)
    """Covariance in rad^2 of the harmonics in quadrature of a piece (see `Waveform`); None where unused."""
    known_drag_s: Estimate | None = None
    """Prior of the drag."""
    seismometer_noise: float | None = None
    """Ratio of a seismometer's own noise to the ground's motion in its record, at the pendulum's frequency;
    None without a seismometer."""

    @property
    def unknown_rad_per_s2_rthz(self) -> float:
        """The drive that remains unknown with a seismometer of that noise, at its best weight."""
        if self.seismometer_noise is None:
            return self.ground_rad_per_s2_rthz
        return self.ground_rad_per_s2_rthz * self.seismometer_noise / hypot(1.0, self.seismometer_noise)

    @classmethod
    def of(cls, fit: FitResult, points: TurningPoints) -> "Conditions":
        """The conditions of a finished run, by its exact fit; its drive is the likeliest one."""
        scale, waveform = fit.ground_fit.noise.scale, fit.evidence.waveform
        return cls(
            scale * float(np.median(points.u_amplitude)),
            scale * float(np.median(points.u_time_s * points.amplitude)),
            fit.ground_fit.density_rad_per_s2_rthz.value,
            sine_covariance=None if waveform is None else waveform.median_covariance,
            known_drag_s=fit.evidence.drag_s,
        )

    def evidence(self, amplitude_rad: Floats) -> Evidence:
        """The waveform of a run through turning points of these amplitudes; its values are zero."""
        if self.sine_covariance is None:
            return Evidence()
        middle = amplitude_rad[PIECE_HALF_CYCLES // 2 :: PIECE_HALF_CYCLES]
        covariance = np.tile(self.sine_covariance, (len(middle), 1, 1))
        nothing = np.zeros((len(middle), len(self.sine_covariance)))
        return Evidence(Waveform(middle, nothing, covariance, 1.0))

    def on_ground(self, rad_per_s2_rthz: float) -> "Conditions":
        """The same measurement on another ground; a seismometer keeps its noise, but not the ratio of it."""
        noise = self.seismometer_noise
        if noise is not None and rad_per_s2_rthz > 0:
            noise = max(LEAST_UNEXPLAINED, noise * self.ground_rad_per_s2_rthz / rad_per_s2_rthz)
        return replace(self, ground_rad_per_s2_rthz=rad_per_s2_rthz, seismometer_noise=noise)


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run between two amplitudes: its duration, and the uncertainty of every parameter after it."""

    first_rad: float
    last_rad: float
    duration_s: float
    half_cycles: int
    u: Mapping[str, float]
    complete: bool = True
    """False where the drive ends the run above the amplitude `last_rad`."""
    values: Mapping[str, float] = field(default_factory=dict, repr=False)
    """Values of the k parameters of the fit."""
    root: Floats = field(default_factory=lambda: np.zeros((0, 0)), repr=False, compare=False)
    """Square root (k, k) of Fisher's information, without the prior of the drag, on relative changes of the
    values (absolute ones for a value of 0)."""

    def u_after(self, count: int, known_drag_s: Estimate | None) -> Mapping[str, float]:
        """Standard uncertainties after `count` such runs, which share one prior of the drag."""
        return self.u if count == 1 else _uncertainties(self.root, self.values, known_drag_s, count)


def planned_run(
    values: Mapping[str, float],
    pendulum: PendulumOnBall,
    conditions: Conditions,
    first_rad: float,
    last_rad: float,
) -> PlannedRun:
    """The planned run from one amplitude to another, for these values of the `DEFAULT_LAW`.

    Raises DataError where the pendulum makes too few half-cycles between the two amplitudes.
    """
    drag = DRAG.key in values
    known = {**values, AMPLITUDE.key: first_rad, TIME.key: 0.0}
    amplitude, time, complete = _decay(known, pendulum, last_rad, conditions)
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
    model = ExactModel(points, pendulum, drag=drag, evidence=conditions.evidence(amplitude))
    step = step_of_density(conditions.unknown_rad_per_s2_rthz, float(np.diff(time).mean())) / model.reference
    coordinates = model.parametrisation.from_physical(known)
    fit_values = {name: known[name] for name in model.names}
    rows = DrivenRows.of(model.linearised_at(coordinates), coordinates, Noise(step=step))
    # sizes of the stated values: the coordinates give 1e-19 for a value of 0, whose column would vanish
    by_coordinates = model.parametrisation.physical(coordinates)[1] / _sizes(fit_values)[:, None]
    root = np.linalg.qr(rows.jacobian @ np.linalg.inv(by_coordinates)).R
    u = _uncertainties(root, fit_values, conditions.known_drag_s)
    return PlannedRun(first_rad, last_rad, float(time[-1]), len(points), u, complete, fit_values, root)


def _uncertainties(
    root: Floats, values: Mapping[str, float], known_drag_s: Estimate | None, count: int = 1
) -> dict[str, float]:
    """Standard uncertainties of the shared parameters after `count` runs, with the prior of the drag once."""
    rows = sqrt(count) * root
    if known_drag_s is not None and DRAG.key in values:
        is_drag = np.array([name == DRAG.key for name in values], dtype=np.float64)
        rows = np.vstack([rows, is_drag * _sizes(values) / known_drag_s.standard_uncertainty])
    u = np.sqrt(np.diag(covariance_of(rows))) * _sizes(values)
    return dict(zip(list(values)[:-2], u.tolist(), strict=False))


def _sizes(values: Mapping[str, float]) -> Floats:
    """Units of relative changes of the values: their sizes, and 1 for a value of 0."""
    return np.array([abs(value) or 1.0 for value in values.values()])


def _decay(
    known: Mapping[str, float], pendulum: PendulumOnBall, last_rad: float, conditions: Conditions
) -> tuple[Floats, Floats, bool]:
    """Amplitudes and times of the law's free decay, and whether it reaches the last amplitude."""
    range_ends = TurningPoints(
        np.array([0, 1], dtype=np.int64),
        np.array([0.0, 1.0]),
        np.ones(2),
        np.array([known[AMPLITUDE.key], last_rad]),
        np.full(2, 1e-3 * last_rad),
    )
    names = DEFAULT_LAW.fit_names(drag=DRAG.key in known)
    parametrisation = DEFAULT_LAW.coordinates(range_ends, pendulum, names)
    parameters = parametrisation.map_parameters(parametrisation.from_physical(known))[0]
    count = 256
    while True:
        decay = DEFAULT_LAW.turning_points(parameters[:-2], np.arange(count, dtype=np.int64))
        amplitude = decay.amplitude * parametrisation.reference
        if not np.isfinite(amplitude[-1]) or amplitude[-1] < last_rad or count > 1 << 16:
            break
        count *= 2
    time = decay.time * parameters[-2]
    half_period_s = float(time[1]) if np.isfinite(time[1]) else inf
    hidden_rad = _HIDDEN_RATIO * step_of_density(conditions.ground_rad_per_s2_rthz, half_period_s)
    is_in_run = np.isfinite(amplitude) & (amplitude >= max(last_rad, hidden_rad))
    complete = bool(hidden_rad <= last_rad and np.nanmin(amplitude) < last_rad)
    return amplitude[is_in_run], time[is_in_run], complete
