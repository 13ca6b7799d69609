"""What a rig as configured will measure: contact, scatter of turning points, motion of the ground."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact import DEFAULT_LAW, DRAG, PendulumOnBall
from processing.deflections import slow_deflections
from processing.errors import ConfigurationError, DataError
from processing.fit import LEAST_UNEXPLAINED, Conditions, FitMethod, sine_covariance
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.spot import SensorModel, SpotTracker
from processing.swing import HarmonicsWatch, swings_of_blocks, turning_points
from processing.units import ARCSEC_RAD, nanoseconds
from rig.analysis import AnalysedRun, Fit, known_drag, read_results, stated_surroundings
from rig.instrument import complete, pendulum_on_ball, sensor_model
from rig.settings import Configuration, load_configuration

_HALF_CYCLES = 100
_FRAMES = 9
_AMPLITUDE_RAD = 3e-4
_FULL_SCALE_DN = 255.0


class PlannedContact(NamedTuple):
    """The contact's values by key, the pendulum, what makes its turning points scatter, the time limit."""

    values: dict[str, float]
    pendulum: PendulumOnBall
    conditions: Conditions
    longest_s: float = math.inf


def expected_of(config: Configuration, frame_noise_rad: float | None = None) -> PlannedContact:
    """What is to be expected of a complete configuration.

    What a rig does not know before its first run is taken from [simulation]: the contact, the spot's size and
    light, air, pointing, and the ground. `frame_noise_rad` is the noise of one frame where it is known
    better, as preflight measures it.

    Raises ConfigurationError: no pendulum, lever or frame rate, or a ground whose density is not stated.
    """
    pendulum = pendulum_on_ball(config)
    if pendulum is None:
        raise ConfigurationError("rig plan needs [pendulum]: state mass_kg and ball_radius_m")
    contact = config.simulation.contact
    drag, _ = known_drag(config, stated_surroundings(config), pendulum, contact.period0_s)
    truth = contact.model_dump() | {DRAG.key: contact.whole_drag_s}
    values = {name: float(truth[name]) for name in DEFAULT_LAW.names(drag=drag.fitted)}
    noise_rad = _frame_noise_rad(config) if frame_noise_rad is None else frame_noise_rad
    u_rad, u_time_s, harmonics_covariance = _half_cycle_uncertainties(config, noise_rad)
    conditions = Conditions(
        u_rad,
        u_time_s * _AMPLITUDE_RAD,
        _drive(config, pendulum),
        sine_covariance=harmonics_covariance,
        known_drag_s=drag.known_s,
        seismometer_noise=_witness_noise(config),
    )
    return PlannedContact(values, pendulum, conditions, config.session.max_duration_s)


def planned_expectation(
    source: Path, overrides: Sequence[str], noise_arcsec: float | None, contact: Path | None
) -> PlannedContact:
    """What is to be expected of a configuration file.

    `noise_arcsec` is the noise of one frame, `contact` a results.json whose first fitted run has the contact.
    """
    config = complete(load_configuration(source, overrides))
    # a file that cannot be used is refused before the work
    known = None if contact is None else _contact_of(contact)
    expected = expected_of(config, None if noise_arcsec is None else noise_arcsec * ARCSEC_RAD)
    if known is None:
        return expected
    # a drag is planned as it will be fitted, whether or not the earlier fit had one
    return expected._replace(values={name: known.get(name, own) for name, own in expected.values.items()})


def expected_of_run(run: AnalysedRun) -> PlannedContact:
    """Contact, noise and ground of a run that was made. Raises DataError where it has no fit."""
    exact, pendulum = run.fitted.get(FitMethod.EXACT), run.pendulum
    if exact is None or pendulum is None:
        raise DataError(f"{run.path}: a plan needs a fitted run: {run.problem or 'it has no fit'}")
    values = {name: exact.estimate(name).value for name in exact.contact_names}
    return PlannedContact(values, pendulum, Conditions.of(exact, run.points))


def expected_of_table(results: Path) -> PlannedContact:
    """Contact, noise and ground of the longest decay of a table or film, as its results have them.

    Raises DataError: no decay in it has a fit of the contact.
    """
    exact, pendulum, points = max(
        (
            (run.fits[FitMethod.EXACT], run.pendulum, run.points)
            for run in read_results(results).runs
            if FitMethod.EXACT in run.fits and run.pendulum is not None
        ),
        key=lambda found: len(found[2]),
        default=(None, None, None),
    )
    if exact is None or pendulum is None or points is None:
        raise DataError(
            f"{results}: no decay in it has a fit of the contact; rig fit TABLE --unit arcsec --config "
            "CONFIG makes one"
        )
    ground = exact.ground
    scale = 1.0 if ground is None else ground.measurement_scale
    conditions = Conditions(
        scale * float(np.median(points.u_amplitude)),
        scale * float(np.median(points.u_time_s * points.amplitude)),
        0.0 if ground is None else ground.density_rad_per_s2_rthz.value,
    )
    return PlannedContact(_values_of(exact), pendulum, conditions)


def _contact_of(results: Path) -> dict[str, float]:
    """The contact's values by key, of the first fitted run of a results file."""
    fit = next(
        (run.fits[FitMethod.EXACT] for run in read_results(results).runs if FitMethod.EXACT in run.fits), None
    )
    if fit is None:
        raise DataError(
            f"{results}: no run in it has a fit of the contact; name another, or leave --contact out"
        )
    return _values_of(fit)


def _values_of(fit: Fit) -> dict[str, float]:
    """The contact's values by key, with the drag where one was fitted."""
    known = DEFAULT_LAW.names(drag=True)
    return {name: fit.parameters[name].value for name in known if name in fit.parameters}


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
    # the mirror turns the beam by twice its own angle
    return config.lever.pixel_pitch_m / (2 * config.lever.arm_m)


def _frame_noise_rad(config: Configuration) -> float:
    """As the tracker states it for the expected spot, with the pointing's jitter."""
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
    # rounding to whole DN adds its own part
    sigma_dn = np.sqrt(
        (sensor.read_noise_e / sensor.gain_e_per_dn) ** 2
        + light_dn / sensor.gain_e_per_dn
        + (sensor.prnu * light_dn) ** 2
    )
    rng = np.random.default_rng(1)
    tracker = SpotTracker(sensor)
    kind = np.uint8 if sensor.full_scale_dn <= 255 else np.uint16
    found = []
    for _ in range(_FRAMES):
        seen = np.clip(
            np.rint(mean_dn + sigma_dn * rng.standard_normal(mean_dn.shape)), 0, sensor.full_scale_dn
        )
        found.append(tracker.track(seen.astype(kind)).u_y_px)
    return float(np.nanmedian(found))


def _half_cycle_uncertainties(
    config: Configuration, noise_rad: float
) -> tuple[float, float, NDArray[np.float64] | None]:
    """Uncertainties of amplitude (rad) and time (s) that the swing detector finds at this noise of a frame,
    and the covariance of the harmonics in quadrature.

    Air and a wandering beam bend the swing as the simulated rig has them, if it is the camera.
    """
    rate_hz, period_s = _frame_rate_hz(config), config.simulation.contact.period0_s
    time_s = np.arange(0.0, 0.5 * _HALF_CYCLES * period_s, 1 / rate_hz)
    swing_rad = _AMPLITUDE_RAD * np.cos(2 * np.pi * time_s / period_s)
    rng = np.random.default_rng(2)
    swing_rad += noise_rad * rng.standard_normal(len(time_s))
    if config.simulated:
        at_hz = np.asarray(np.fft.rfftfreq(len(time_s), 1 / rate_hz)[1:], dtype=np.float64)
        size = np.sqrt(0.25 * len(time_s) * rate_hz * _slow_density(config, at_hz))
        waves = size * (rng.standard_normal((2, len(at_hz))).T @ [1, 1j])
        swing_rad += np.fft.irfft(np.append(0.0, waves), len(time_s))
    seen = slow_deflections(nanoseconds(time_s), swing_rad, noise_rad)
    swings = swings_of_blocks([seen])
    points, waveform = turning_points(swings), HarmonicsWatch(swings)
    waveform.update(seen)
    if len(points) < _HALF_CYCLES // 2:
        raise ConfigurationError(
            f"{rate_hz:g} frames/s show a swing of {period_s:g} s too seldom: raise camera.frame_rate_hz"
        )
    later = slice(len(points) // 2, None)
    u_amplitude, u_time = points.u_amplitude[later], points.u_time_s[later]
    return float(np.median(u_amplitude)), float(np.median(u_time)), sine_covariance(waveform.found())


def _slow_density(config: Configuration, at_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """One-sided density, in rad^2/Hz, of what bends the beam slowly: air, a wandering laser."""
    said = config.simulation.disturbances
    inside = (at_hz >= said.air_from_hz) & (at_hz <= said.air_to_hz)
    air_rad2 = (said.air_arcsec * ARCSEC_RAD) ** 2 / math.log(said.air_to_hz / said.air_from_hz)
    walk_rad = said.pointing_walk_px_per_sqrt_s * _rad_per_px(config)
    air, walk = np.where(inside, air_rad2 / at_hz, 0.0), 2 * walk_rad**2 / (2 * math.pi * at_hz) ** 2
    shared, noise = _without_reference(config)
    common = shared * air + (walk if shared else 0.0)
    # Wiener's filter leaves the smaller of motion and noise
    left = common if math.isinf(noise) else common * noise / np.maximum(common + noise, np.finfo(float).tiny)
    return np.asarray(air + walk - common + left)


def _without_reference(config: Configuration) -> tuple[float, float]:
    """Share of the air's power that both spots have, and density of the reference's own noise in rad^2/Hz.

    No share without a reference, or where the simulated rig draws none.
    """
    truth, stated = config.simulation.reference, config.reference
    if stated is None or not truth.relative > 0:
        return 0.0, math.inf
    optics, sensor = config.simulation.optics, sensor_model(config, _FULL_SCALE_DN)
    peak_dn = truth.relative * optics.peak_dn / 255 * sensor.full_scale_dn
    u_px = truth.gain * _tracked_u_px(sensor, peak_dn, optics.sigma_y_px)
    return truth.air_common**2, 2 * (u_px * _rad_per_px(config)) ** 2 / _frame_rate_hz(config)


def _witness_noise(config: Configuration) -> float | None:
    """Noise of the configured witness over the ground that it sees, at the swing's frequency.

    Of one whose noise nobody has stated, what two real instruments at one place differ by; `--witness` says
    more.
    """
    kind = config.witness.kind
    if kind == "none":
        return None
    noise = config.simulation.witness.noise_m_per_s2_per_sqrt_hz if kind == "simulated" else 0.0
    level = _ground_level(config)
    return max(LEAST_UNEXPLAINED, noise / level) if level > 0 else LEAST_UNEXPLAINED


def _ground_level(config: Configuration) -> float:
    """Acceleration of the ground at the pendulum's frequency, in m/s^2/sqrt(Hz); 0 where none is known."""
    truth, at = config.simulation.ground, np.array([1 / config.simulation.contact.period0_s])
    low, high = float(nlnm_db(at)[0]), float(nhnm_db(at)[0])
    if truth.model == "white":
        return truth.white_m_per_s2_per_sqrt_hz
    if truth.model == "peterson":
        above_db = (
            truth.between_noise_models * (high - low)
            if truth.above_low_noise_db is None
            else truth.above_low_noise_db
        )
        return float(density_of_db(np.array([low + above_db]))[0])
    return 0.0


def _drive(config: Configuration, pendulum: PendulumOnBall) -> float:
    """Angular acceleration of the pendulum by the ground at its own frequency, in rad/s^2/sqrt(Hz)."""
    truth, at_hz = config.simulation.ground, 1 / config.simulation.contact.period0_s
    if truth.model == "file":
        raise ConfigurationError("simulation.ground.model = 'file': state its drive with --ground")
    level = _ground_level(config)
    height_m = truth.mass_centre_height_m
    if config.pendulum is not None and config.pendulum.mass_centre_height_m is not None:
        height_m = config.pendulum.mass_centre_height_m
    turned = level * height_m / (pendulum.gravity_m_per_s2 * pendulum.ball_radius_m)
    return (2 * math.pi * at_hz) ** 2 * math.hypot(turned, truth.tilt_rad_per_sqrt_hz)
