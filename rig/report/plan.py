"""`rig plan`: the assumptions of a plan, and the uncertainties of its planned runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact import DEFAULT_LAW, DRAG, PendulumOnBall
from processing.deflections import slow_deflections
from processing.errors import ConfigurationError, DataError
from processing.estimate import WELL_DETERMINED
from processing.fit import LEAST_UNEXPLAINED, Conditions, FitMethod, PlannedRun, planned_run, waveform_of
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.spot import SensorModel, SpotTracker
from processing.swing import HarmonicsMeasurement, TurningPoints, half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD, nanoseconds
from rig.analysis import AnalysedRun, Fit, drag_of_fit, read_results, stated_ambient
from rig.instrument import complete, pendulum_on_ball, sensor_model
from rig.settings import Configuration, load_configuration
from rig.terminal import Table, percent, plain, quantity

_HALF_CYCLES = 100
_TRIAL_FRAMES = 9
_AMPLITUDE_RAD = 3e-4
_FULL_SCALE_DN = 255.0


class PlannedContact(NamedTuple):
    """The assumptions of a plan."""

    values: dict[str, float]
    """Values of the contact by key."""
    pendulum: PendulumOnBall
    conditions: Conditions
    """Conditions that make turning points scatter."""
    longest_s: float = math.inf
    """Time limit of a run."""
    unknown: tuple[str, ...] = ()
    """Keys of the values that the source of the plan does not determine."""


def planned_contact(config: Configuration, frame_noise_rad: float | None = None) -> PlannedContact:
    """The assumptions for runs with a complete configuration.

    Values unknown before the first run are taken from [simulation]: the contact, size and light of the spot,
    air, pointing, and the ground. `frame_noise_rad` is the noise of one frame if it was measured, as by the
    preflight.

    Raises ConfigurationError without pendulum, lever or frame rate, or for a ground without stated density.
    """
    pendulum = pendulum_on_ball(config)
    if pendulum is None:
        raise ConfigurationError("rig plan needs [pendulum]: state mass_kg and ball_radius_m")
    contact = config.simulation.contact
    drag, _ = drag_of_fit(config, stated_ambient(config), pendulum, contact.period0_s)
    truth = contact.model_dump() | {DRAG.key: contact.whole_drag_s}
    values = {name: float(truth[name]) for name in DEFAULT_LAW.names(drag=drag.fitted)}
    noise_rad = _frame_noise_rad(config) if frame_noise_rad is None else frame_noise_rad
    u_rad, u_time_s, harmonics_covariance = _half_cycle_uncertainties(config, noise_rad)
    conditions = Conditions(
        u_rad,
        u_time_s * _AMPLITUDE_RAD,
        _drive(config, pendulum),
        sine_covariance=harmonics_covariance,
        known_drag_s=drag.prior_s,
        seismometer_noise=_seismometer_noise(config),
    )
    return PlannedContact(values, pendulum, conditions, config.session.max_duration_s)


def planned_contact_of_file(
    source: Path, overrides: Sequence[str], noise_arcsec: float | None, contact: Path | None
) -> PlannedContact:
    """The assumptions for runs with a configuration file.

    `noise_arcsec` is the noise of one frame, `contact` a results.json whose first fitted run has the contact.
    """
    config = complete(load_configuration(source, overrides))
    # read first, so that an unusable file is refused before the work
    fitted = [] if contact is None else _fitted_runs(contact, "name another, or leave --contact out")
    planned = planned_contact(config, None if noise_arcsec is None else noise_arcsec * ARCSEC_RAD)
    if not fitted:
        return planned
    known = _planned_contact(fitted[0][0], planned.pendulum, planned.conditions)
    # the drag is planned as it will be fitted, whether or not the earlier fit had one
    values = {name: known.values.get(name, value) for name, value in planned.values.items()}
    return planned._replace(values=values, unknown=known.unknown)


def planned_contact_of_run(run: AnalysedRun) -> PlannedContact:
    """Contact, noise and ground of a measured run; raises DataError if it has no fit."""
    exact, pendulum = run.fitted.get(FitMethod.EXACT), run.pendulum
    if exact is None or pendulum is None:
        raise DataError(f"{run.path}: a plan needs a fitted run: {run.problem or 'it has no fit'}")
    return _planned_contact(run.fits[FitMethod.EXACT], pendulum, Conditions.of(exact, run.points))


def planned_contact_of_table(results: Path) -> PlannedContact:
    """The assumptions from the longest decay of a table or film; raises DataError without a fit."""
    fitted = _fitted_runs(results, "rig fit TABLE --unit arcsec --config CONFIG makes one")
    exact, pendulum, points = max(fitted, key=lambda decay: len(decay[2]))
    ground = exact.ground
    scale = 1.0 if ground is None else ground.measurement_scale
    conditions = Conditions(
        scale * float(np.median(points.u_amplitude)),
        scale * float(np.median(points.u_time_s * points.amplitude)),
        0.0 if ground is None else ground.density_rad_per_s2_rthz.value,
    )
    return _planned_contact(exact, pendulum, conditions)


def _fitted_runs(results: Path, remedy: str) -> list[tuple[Fit, PendulumOnBall, TurningPoints]]:
    """Exact fit, pendulum and turning points of the fitted runs of a file; raises DataError for none."""
    fitted = [
        (run.fits[FitMethod.EXACT], run.pendulum, run.points)
        for run in read_results(results).runs
        if FitMethod.EXACT in run.fits and run.pendulum is not None
    ]
    if not fitted:
        raise DataError(f"{results}: nothing in it has a fit of the contact; {remedy}")
    return fitted


def _planned_contact(fit: Fit, pendulum: PendulumOnBall, conditions: Conditions) -> PlannedContact:
    """The values of a fit, with the drag if it was fitted, and which of them are not well determined."""
    known = {name: fit.parameters[name] for name in DEFAULT_LAW.names(drag=True) if name in fit.parameters}
    # a plan does not depend on the value of the drag, which therefore never counts as unknown
    unknown = tuple(
        name
        for name, (value, u) in known.items()
        if name != DRAG.key and not u <= WELL_DETERMINED * abs(value)
    )
    values = {name: value for name, (value, _) in known.items()}
    return PlannedContact(values, pendulum, conditions, unknown=unknown)


def _frame_rate_hz(config: Configuration) -> float:
    rate_hz = config.camera.frame_rate_hz
    if rate_hz is None and config.simulated:
        rate_hz = config.simulation.clock.frame_rate_hz
    if rate_hz is None:
        raise ConfigurationError("rig plan needs camera.frame_rate_hz: state the rate that will be asked for")
    return rate_hz


def _rad_per_px(config: Configuration) -> float:
    if config.lever is None:
        raise ConfigurationError("rig plan needs [lever]: state arm_m and pixel_pitch_m")
    # the beam turns by twice the angle of the mirror
    return config.lever.pixel_pitch_m / (2 * config.lever.arm_m)


def _frame_noise_rad(config: Configuration) -> float:
    """Noise of one frame: the tracker's u for the expected spot; if simulated, with the pointing's jitter."""
    optics, truth = config.simulation.optics, config.simulation
    sensor = sensor_model(config, _FULL_SCALE_DN)
    u_px = _tracked_u_px(sensor, optics.peak_dn / 255 * sensor.full_scale_dn, optics.sigma_y_px)
    if config.simulated:
        u_px = math.hypot(u_px, truth.disturbances.pointing_jitter_px)
    return u_px * _rad_per_px(config)


def _tracked_u_px(sensor: SensorModel, peak_dn: float, sigma_px: float) -> float:
    side = 2 * math.ceil(8 * sigma_px)
    y, x = np.mgrid[:side, :side] - 0.5 * (side - 1)
    light_dn = peak_dn * np.exp(-0.5 * (x**2 + y**2) / sigma_px**2)
    mean_dn = sensor.pedestal_dn + light_dn
    # the rounding of the images to whole DN adds to this noise
    sigma_dn = np.sqrt(
        (sensor.read_noise_e / sensor.gain_e_per_dn) ** 2
        + light_dn / sensor.gain_e_per_dn
        + (sensor.prnu * light_dn) ** 2
    )
    rng = np.random.default_rng(1)
    tracker = SpotTracker(sensor)
    pixel_type = np.uint8 if sensor.full_scale_dn <= 255 else np.uint16
    u_px = []
    for _ in range(_TRIAL_FRAMES):
        noisy_dn = mean_dn + sigma_dn * rng.standard_normal(mean_dn.shape)
        image = np.clip(np.rint(noisy_dn), 0, sensor.full_scale_dn).astype(pixel_type)
        u_px.append(tracker.track(image).u_y_px)
    return float(np.nanmedian(u_px))


def _half_cycle_uncertainties(
    config: Configuration, noise_rad: float
) -> tuple[float, float, NDArray[np.float64] | None]:
    """Uncertainties of amplitude (rad) and time (s) of half-cycles; covariance of harmonics in quadrature."""
    rate_hz, period_s = _frame_rate_hz(config), config.simulation.contact.period0_s
    time_s = np.arange(0.0, 0.5 * _HALF_CYCLES * period_s, 1 / rate_hz)
    swing_rad = _AMPLITUDE_RAD * np.cos(2 * np.pi * time_s / period_s)
    rng = np.random.default_rng(2)
    swing_rad += noise_rad * rng.standard_normal(len(time_s))
    if config.simulated:
        # its air and the wander of its beam distort the swing
        frequency_hz = np.asarray(np.fft.rfftfreq(len(time_s), 1 / rate_hz)[1:], dtype=np.float64)
        size = np.sqrt(0.25 * len(time_s) * rate_hz * _slow_density(config, frequency_hz))
        waves = size * (rng.standard_normal((2, len(frequency_hz))).T @ [1, 1j])
        swing_rad += np.fft.irfft(np.append(0.0, waves), len(time_s))
    deflections = slow_deflections(nanoseconds(time_s), swing_rad, noise_rad)
    half_cycles = half_cycles_of_blocks([deflections])
    points, harmonics = turning_points(half_cycles), HarmonicsMeasurement(half_cycles)
    harmonics.update(deflections)
    if len(points) < _HALF_CYCLES // 2:
        raise ConfigurationError(
            f"{rate_hz:g} frames/s show a swing of {period_s:g} s too seldom: raise camera.frame_rate_hz"
        )
    second_half = slice(len(points) // 2, None)
    u_amplitude, u_time = points.u_amplitude[second_half], points.u_time_s[second_half]
    waveform = waveform_of(harmonics.harmonics())
    covariance = None if waveform is None else waveform.median_covariance
    return float(np.median(u_amplitude)), float(np.median(u_time)), covariance


def _slow_density(config: Configuration, frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """One-sided density in rad^2/Hz of the slow deflection of the beam by air and a wandering laser."""
    disturbances = config.simulation.disturbances
    is_inside = (frequency_hz >= disturbances.air_from_hz) & (frequency_hz <= disturbances.air_to_hz)
    air_rad2 = (disturbances.air_arcsec * ARCSEC_RAD) ** 2 / math.log(
        disturbances.air_to_hz / disturbances.air_from_hz
    )
    walk_rad = disturbances.pointing_walk_px_per_sqrt_s * _rad_per_px(config)
    air = np.where(is_inside, air_rad2 / frequency_hz, 0.0)
    walk = 2 * walk_rad**2 / (2 * math.pi * frequency_hz) ** 2
    shared, noise = _reference_share_and_noise(config)
    common = shared * air + (walk if shared else 0.0)
    # a Wiener filter leaves roughly the smaller of motion and noise
    rest = common if math.isinf(noise) else common * noise / np.maximum(common + noise, np.finfo(float).tiny)
    return np.asarray(air + walk - common + rest)


def _reference_share_and_noise(config: Configuration) -> tuple[float, float]:
    """Fraction of the air's power that both spots share, and noise density of the reference in rad^2/Hz."""
    truth, reference = config.simulation.reference, config.reference
    if reference is None or not truth.relative > 0:
        return 0.0, math.inf
    optics, sensor = config.simulation.optics, sensor_model(config, _FULL_SCALE_DN)
    peak_dn = truth.relative * optics.peak_dn / 255 * sensor.full_scale_dn
    u_px = truth.gain * _tracked_u_px(sensor, peak_dn, optics.sigma_y_px)
    return truth.air_common**2, 2 * (u_px * _rad_per_px(config)) ** 2 / _frame_rate_hz(config)


def _seismometer_noise(config: Configuration) -> float | None:
    """Noise of the auxiliary seismometer over the ground at the pendulum's frequency; None without one."""
    kind = config.seismometer.kind
    if kind == "none":
        return None
    # where no noise is stated, the difference of two real instruments at one place
    noise = config.simulation.seismometer.noise_m_per_s2_per_sqrt_hz if kind == "simulated" else 0.0
    level = _ground_level(config)
    return max(LEAST_UNEXPLAINED, noise / level) if level > 0 else LEAST_UNEXPLAINED


def _ground_level(config: Configuration) -> float:
    """Acceleration of the ground at the pendulum's frequency in m/s^2/sqrt(Hz); 0 if unknown."""
    truth, frequency_hz = config.simulation.ground, np.array([1 / config.simulation.contact.period0_s])
    low_db, high_db = float(nlnm_db(frequency_hz)[0]), float(nhnm_db(frequency_hz)[0])
    if truth.model == "white":
        return truth.white_m_per_s2_per_sqrt_hz
    if truth.model == "peterson":
        above_db = truth.above_low_noise_db
        if above_db is None:
            above_db = truth.between_noise_models * (high_db - low_db)
        return float(density_of_db(np.array([low_db + above_db]))[0])
    return 0.0


def _drive(config: Configuration, pendulum: PendulumOnBall) -> float:
    """Angular acceleration of the pendulum by the ground at its own frequency, in rad/s^2/sqrt(Hz)."""
    truth, frequency_hz = config.simulation.ground, 1 / config.simulation.contact.period0_s
    if truth.model == "file":
        raise ConfigurationError("simulation.ground.model = 'file': state its drive with --ground")
    level = _ground_level(config)
    tilt = level * truth.mass_centre_height_m / (pendulum.gravity_m_per_s2 * pendulum.ball_radius_m)
    return (2 * math.pi * frequency_hz) ** 2 * math.hypot(tilt, truth.tilt_rad_per_sqrt_hz)


@dataclass(frozen=True, slots=True)
class Plan:
    """Planned runs of an assumed contact, also those that last longer than the time limit."""

    contact: PlannedContact
    runs: tuple[PlannedRun, ...]
    counts: tuple[int, ...] = (1,)
    """Numbers of repetitions of each run, for which uncertainties are calculated."""

    def combined_u(self, run: PlannedRun, count: int) -> Mapping[str, float]:
        """Uncertainty by parameter of `count` such runs together."""
        return run.u_after(count, self.contact.conditions.known_drag_s)

    @property
    def rows(self) -> list[dict[str, float]]:
        """Amplitudes, duration and uncertainties of every planned run, for each number of repetitions."""
        return [
            {
                "first_arcsec": run.first_rad / ARCSEC_RAD,
                "last_arcsec": run.last_rad / ARCSEC_RAD,
                "duration_s": run.duration_s,
                "half_cycles": run.half_cycles,
                "runs": count,
                **{f"u_{name}": u for name, u in self.combined_u(run, count).items()},
            }
            for run, count in product(self.runs, self.counts)
        ]


def make_plan(
    contact: PlannedContact,
    first_arcsec: Sequence[float],
    last_arcsec: Sequence[float],
    ground_rad_per_s2_rthz: float | None = None,
    counts: Sequence[int] = (1,),
    seismometer_noise: float | None = None,
) -> Plan:
    """Plan runs between all first and last amplitudes; raises DataError if no pair of them makes a run."""
    conditions = contact.conditions
    if ground_rad_per_s2_rthz is not None:
        conditions = conditions.on_ground(ground_rad_per_s2_rthz)
    if seismometer_noise is not None:
        conditions = replace(conditions, seismometer_noise=seismometer_noise)
    runs, problem = [], "a last amplitude must lie below a first one"
    for first, last in product(first_arcsec, last_arcsec):
        if last < first:
            try:
                amplitudes_rad = first * ARCSEC_RAD, last * ARCSEC_RAD
                runs.append(planned_run(contact.values, contact.pendulum, conditions, *amplitudes_rad))
            except DataError as error:
                problem = str(error)
    if not runs:
        raise DataError(f"no such run: {problem}")
    return Plan(contact._replace(conditions=conditions), tuple(runs), tuple(sorted(set(counts))))


_MAX_RELATIVE_U = 10.0
"""Relative uncertainty from which on a value counts as unknown."""


def _relative_u_text(u: float, value: float, unit: str) -> str:
    """Relative uncertainty in per cent; the uncertainty with its unit if the value is 0."""
    if not value:
        return f"{plain(u, 2)} {unit}".rstrip()
    relative_u = u / abs(value)
    return percent(relative_u) if relative_u < _MAX_RELATIVE_U else "unknown"


def plan_table(plan: Plan) -> Table:
    """Table with a row for each run or series: time of all runs, relative uncertainties of parameters."""
    names, values, contact = list(plan.runs[0].u), dict(plan.contact.values), plan.contact
    if all(run.u.get(DRAG.key, 0.0) > abs(values.get(DRAG.key, 0.0)) for run in plan.runs):
        # no uncertainty is relative to a drag that no run would see
        values[DRAG.key] = 0.0
    units = [quantity(name).unit for name in names]
    rows = []
    for run, count in product(plan.runs, plan.counts):
        first_arcsec, last_arcsec = run.first_rad / ARCSEC_RAD, run.last_rad / ARCSEC_RAD
        total_min, u = count * run.duration_s / 60, plan.combined_u(run, count).values()
        remark = "" if run.complete else " (the ground ends it earlier)"
        remark += "" if run.duration_s <= contact.longest_s else " *"
        relative = map(_relative_u_text, u, (values[name] for name in names), units)
        amplitudes = f"{first_arcsec:g} to {last_arcsec:g}{remark}"
        rows.append([amplitudes, f"{count}", f"{total_min:.1f}", *relative])
    note = ""
    if contact.unknown:
        unknown = ", ".join(quantity(name).symbol for name in contact.unknown)
        note = (
            f"NOT RELIABLE: what this plan starts from does not determine {unknown}, so the contact may be "
            "another; plan from a longer run, or from a configuration. "
        )
    conditions = contact.conditions
    note += (
        "Standard uncertainties from the swings alone, in per cent of the value where no unit is given; "
        "total time of all runs. One amplitude is measured to "
        f"{plain(conditions.u_amplitude_rad / ARCSEC_RAD, 2)} arcsec; the drive of the ground is "
        f"{plain(conditions.ground_rad_per_s2_rthz, 2)} rad/s²/√Hz"
    )
    if conditions.seismometer_noise is not None:
        note += f", {plain(conditions.unknown_rad_per_s2_rthz, 2)} with the seismometer"
    note += "."
    if any(run.duration_s > contact.longest_s for run in plan.runs):
        note += f" * session.max_duration_s = {contact.longest_s:g} would end it earlier: raise it for this."
    head = ("amplitudes, arcsec", "runs", "min", *(f"u({quantity(name).symbol})" for name in names))
    return Table("plan", "Expected uncertainties", head, rows, note)
