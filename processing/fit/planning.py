"""Planned runs: standard uncertainties of a law's parameters before a run is made.

The turning points of a run follow from the law, their scatter from the measurement and the ground's drive.
The information that they hold (Fisher's matrix of the driven model) bounds every uncertainty from below, and
the fit comes near to this bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, inf, sqrt

import numpy as np

from processing.arrays import Floats
from processing.contact import AMPLITUDE, DEFAULT_LAW, DRAG, TIME, Law, PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.effects import rows_with_drifts
from processing.fit.evidence import Evidence, Waveform
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import FEWEST_HALF_CYCLES
from processing.fit.ground import Noise, step_of_density
from processing.fit.known_drive import LEAST_UNEXPLAINED
from processing.fit.result import FitResult
from processing.least_squares import covariance_of
from processing.swing import PIECE_HALF_CYCLES, TurningPoints

_RUN_PARAMETERS = ("period0_s", AMPLITUDE.key, TIME.key)
"""Parameters of which each run has its own."""
_UNKNOWN_U = 1e6
"""Minimum relative uncertainty of what counts as unknown: rounding gives such values of a singular matrix."""
_HIDDEN_RATIO = 10.0
"""A run ends where the amplitude is this many times the ground's step in a half-swing."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions that make turning points scatter: their measurement, and the drive.

    `u_time_amplitude_s_rad` is the product of a time's uncertainty and its amplitude; `averaged` is that of
    `Noise`. `sine_covariance` is the covariance in rad^2 of the harmonics in quadrature of a piece (see
    `Waveform`), None where they are not used, and `known_drag_s` the prior of the drag. `seismometer_noise`
    is the ratio of a seismometer's own noise to the ground's motion in its record, at the pendulum's
    frequency; None without a seismometer.
    """

    u_amplitude_rad: float
    u_time_amplitude_s_rad: float
    ground_rad_per_s2_rthz: float = 0.0
    averaged: bool = True
    sine_covariance: Floats | None = field(default=None, compare=False)
    known_drag_s: Estimate | None = None
    seismometer_noise: float | None = None

    @property
    def unknown_rad_per_s2_rthz(self) -> float:
        """The drive that remains unknown with a seismometer of that noise, at its best weight."""
        if self.seismometer_noise is None:
            return self.ground_rad_per_s2_rthz
        return self.ground_rad_per_s2_rthz * self.seismometer_noise / hypot(1.0, self.seismometer_noise)

    @classmethod
    def of(cls, fit: FitResult, points: TurningPoints) -> "Conditions":
        """The conditions of a finished run; its drive is the likeliest one."""
        scale = 1.0 if fit.ground is None else fit.ground.noise.scale
        waveform = fit.evidence.waveform
        return cls(
            scale * float(np.median(points.u_amplitude)),
            scale * float(np.median(points.u_time_s * points.amplitude)),
            0.0 if fit.ground is None else fit.ground.density_rad_per_s2_rthz.value,
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
    """One run between two amplitudes: how long it lasts, and the uncertainty of every parameter after it.

    `complete` is False where the drive ends the run above the amplitude `last_rad`. `values` are those of the
    k parameters of the fit. `root` (k, k + 1) is a square root of Fisher's information, without the prior of
    the drag: on relative changes of the values (absolute ones for a value of 0), and on a relative growth of
    the friction over the run.
    """

    first_rad: float
    last_rad: float
    duration_s: float
    half_cycles: int
    u: Mapping[str, float]
    complete: bool = True
    values: Mapping[str, float] = field(default_factory=dict, repr=False)
    root: Floats = field(default_factory=lambda: np.zeros((0, 1)), repr=False, compare=False)

    def u_after(self, count: int, known_drag_s: Estimate | None) -> Mapping[str, float]:
        """Standard uncertainties after `count` such runs; they share what is known of the drag before."""
        return self.u if count == 1 else _uncertainties(self.root, self.values, known_drag_s, count)


def planned_run(
    values: Mapping[str, float],
    pendulum: PendulumOnBall | None,
    conditions: Conditions,
    first_rad: float,
    last_rad: float,
    *,
    law: Law = DEFAULT_LAW,
) -> PlannedRun:
    """The planned run from one amplitude to another, for a law with these values.

    Raises
    ------
    DataError
        The pendulum makes too few half-cycles between the two amplitudes.
    """
    drag = DRAG.key in values
    names = law.fit_names(calibrated=pendulum is not None, drag=drag)
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
    model = ExactModel(points, pendulum, law=law, drag=drag, evidence=conditions.evidence(amplitude))
    step = step_of_density(conditions.unknown_rad_per_s2_rthz, float(np.diff(time).mean())) / model.reference
    noise, columns = Noise(step=step, averaged=conditions.averaged), model.columns.from_physical(known)
    all_known = {name: known[name] for name in model.names}
    root = np.linalg.qr(relative_jacobian(model, columns, all_known, noise)).R
    u_of = _uncertainties(root, all_known, conditions.known_drag_s)
    return PlannedRun(first_rad, last_rad, float(time[-1]), len(points), u_of, complete, all_known, root)


def _uncertainties(
    root: Floats, values: Mapping[str, float], known_drag_s: Estimate | None, count: int = 1
) -> dict[str, float]:
    """Standard uncertainties of the shared parameters after `count` runs, with the prior of the drag once."""
    rows = np.vstack([sqrt(count) * root[:, :-1], *_drag_prior_row(known_drag_s, values)])
    u = np.sqrt(np.diag(covariance_of(rows))) * _sizes(values)
    return dict(zip(list(values)[:-2], u.tolist(), strict=False))


def relative_jacobian(
    model: ExactModel, columns: Floats, values: Mapping[str, float], noise: Noise
) -> Floats:
    """Derivatives (n, k + 1) of a run's residuals with respect to relative changes of the parameters, whose
    `values` are at `columns` (absolute changes of a value of 0), and with respect to the growth of the
    friction from its first turning point to its last."""
    rows = rows_with_drifts(model.linearised_at(columns), columns, noise)
    # sizes by the stated values: by those of the columns a value of 0 is 1e-19, whose column would vanish
    _, to_physical = model.columns.physical(columns)
    by_value = rows.jacobian @ np.linalg.inv(to_physical / _sizes(values)[:, None])
    return np.column_stack([by_value, rows.by_errors[:, :2].sum(axis=1)])


def _sizes(values: Mapping[str, float]) -> Floats:
    """What one relative change of each value is: its size, and 1 of its unit for a value of 0."""
    return np.array([abs(value) or 1.0 for value in values.values()])


def _drag_prior_row(known_drag_s: Estimate | None, values: Mapping[str, float]) -> list[Floats]:
    """The prior of the drag as one further row; no row without a prior."""
    if known_drag_s is None or DRAG.key not in values:
        return []
    row = np.array([name == DRAG.key for name in values], dtype=np.float64)
    return [row * _sizes(values) / known_drag_s.standard_uncertainty]


@dataclass(frozen=True, slots=True)
class PlannedSeries:
    """Runs of one contact, whose friction grows evenly during the runs and between them.

    In one decay the amplitude falls with time, so that the exponent p absorbs the effect of ageing. Runs that
    pass the same amplitudes at other ages separate the two: from other first amplitudes, or after waiting.

    Attributes
    ----------
    runs, waiting_s
        The runs in order, and the time between the end of one and the beginning of the next.
    u
        Standard uncertainties of the shared parameters at the middle of the series, with the ageing unknown.
    u_steady
        The same for a contact that is known not to age.
    u_ageing_per_s
        Standard uncertainty of the friction's relative growth; infinite where the runs do not determine it.
    """

    runs: tuple[PlannedRun, ...]
    waiting_s: float
    u: Mapping[str, float]
    u_steady: Mapping[str, float]
    u_ageing_per_s: float

    @property
    def duration_s(self) -> float:
        """Duration of all runs with the waiting between them."""
        return sum(run.duration_s for run in self.runs) + self.waiting_s * (len(self.runs) - 1)


def planned_series(
    runs: Sequence[PlannedRun], waiting_s: float = 0.0, known_drag_s: Estimate | None = None
) -> PlannedSeries:
    """The series of planned runs, one after the other.

    Every run has its own period, first amplitude and time; the prior of the drag counts once.
    """
    names = list(runs[0].values)
    shared = [name for name in names if name not in _RUN_PARAMETERS]
    stacked = series_jacobian(names, [(run.root, run.duration_s) for run in runs], waiting_s)
    prior_rows = np.zeros((0, stacked.shape[1]))
    for row in _drag_prior_row(known_drag_s, runs[0].values):
        prior_rows = np.zeros((1, stacked.shape[1]))
        prior_rows[0, : len(shared)] = row[[names.index(name) for name in shared]]
    stacked = np.vstack([stacked, prior_rows])
    u = np.sqrt(np.diag(covariance_of(stacked)))
    steady = np.sqrt(np.diag(covariance_of(np.delete(stacked, len(shared), axis=1))))
    size = _sizes({name: runs[0].values[name] for name in shared})
    u_growth = float(u[len(shared)]) if u[len(shared)] < _UNKNOWN_U else inf
    found = PlannedSeries(
        tuple(runs), waiting_s,
        {name: u[k] * size[k] for k, name in enumerate(shared)},
        {name: steady[k] * size[k] for k, name in enumerate(shared)}, u_growth,
    )  # fmt: skip
    return replace(found, u_ageing_per_s=u_growth / found.duration_s)


def series_jacobian(names: Sequence[str], runs: Sequence[tuple[Floats, float]], waiting_s: float) -> Floats:
    """Derivatives of the residuals of consecutive runs with respect to shared parameters, ageing and their
    own parameters.

    `runs` gives for each run the derivatives of `relative_jacobian` and the duration in s.

    The first columns are relative changes of the shared parameters, then the relative growth of the friction
    from the first turning point of all to the last, then each run's own parameters.
    """
    shared = [k for k, name in enumerate(names) if name not in _RUN_PARAMETERS]
    own = [k for k, name in enumerate(names) if name in _RUN_PARAMETERS]
    friction = [names.index(name) for name in ("b", "c")]
    ends_s = np.cumsum([duration_s + waiting_s for _, duration_s in runs]) - waiting_s
    whole_s, rows = float(ends_s[-1]), []
    for place, ((root, duration_s), end_s) in enumerate(zip(runs, ends_s.tolist(), strict=True)):
        row = np.zeros((len(root), len(shared) + 1 + len(own) * len(runs)))
        row[:, : len(shared)] = root[:, shared]
        # the age at the run's middle makes all of its friction larger, and the drift within it is added
        later_s = end_s - 0.5 * duration_s - 0.5 * whole_s
        row[:, len(shared)] = (duration_s * root[:, -1] + later_s * root[:, friction].sum(axis=1)) / whole_s
        begin = len(shared) + 1 + len(own) * place
        row[:, begin : begin + len(own)] = root[:, own]
        rows.append(row)
    return np.concatenate(rows)


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
    range_ends = TurningPoints(
        np.array([0, 1], dtype=np.int64),
        np.array([0.0, 1.0]),
        np.ones(2),
        np.array([first_rad, last_rad]),
        np.full(2, 1e-3 * last_rad),
    )
    columns = law.columns(range_ends, pendulum, names)
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
    hidden_rad = _HIDDEN_RATIO * step_of_density(conditions.ground_rad_per_s2_rthz, half_period_s)
    lasting = np.isfinite(amplitude) & (amplitude >= max(last_rad, hidden_rad))
    complete = bool(hidden_rad <= last_rad and np.nanmin(amplitude) < last_rad)
    return amplitude[lasting], time[lasting], complete
