"""The configured camera: its settings, the times of its light, a simulated calibration; observer guard."""

import logging
import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import ParamSpec, TypeVar

from acquisition.camera import Camera, CameraInfo, CameraSettings
from acquisition.cameras import drivers
from acquisition.simulation.settings import SimulationSettings
from calibration import GLOBAL, Axes, Lever, Shutter
from processing.contact import Material
from processing.errors import ConfigurationError
from processing.spot import SensorModel
from rig.instrument.calibration import fill_from_files
from rig.settings import BalanceSettings, Configuration, PendulumSettings


def make_camera(config: Configuration) -> Camera:
    """The configured camera, not opened yet."""
    name = config.camera.driver
    sections = [getattr(config, section) for section in drivers.find_driver(name).sections]
    return drivers.make_camera(name, *(sections or [config.camera.driver_settings()]))


def camera_settings(config: Configuration) -> CameraSettings:
    """The settings requested from the camera."""
    return CameraSettings(**{name: getattr(config.camera, name) for name in CameraSettings.model_fields})


_IMAGE_KEYS = (
    "exposure_us", "gain_db", "frame_rate_hz", "pixel_format",
    "width_px", "height_px", "offset_x_px", "offset_y_px",
)  # fmt: skip


def with_read_back(requested: CameraSettings, applied: CameraSettings) -> CameraSettings:
    """The settings that reproduce the images: as requested, or else as read back from the camera."""
    unrequested = [name for name in _IMAGE_KEYS if getattr(requested, name) is None]
    return requested.model_copy(update={name: getattr(applied, name) for name in unrequested})


def setting_differences(requested: CameraSettings, applied: CameraSettings) -> list[str]:
    """One line for each setting in which the camera differs from the request."""
    lines = []
    settings = requested.model_dump(exclude_none=True, exclude={"features"})
    rows = [(name, value, getattr(applied, name)) for name, value in settings.items()]
    rows += [
        (f"features.{name}", value, applied.features.get(name, "nothing"))
        for name, value in requested.features.items()
    ]
    for name, value, report in rows:
        is_number = isinstance(value, float) and isinstance(report, int | float)
        if report != value and not (is_number and abs(report - value) <= 1e-3 * abs(value)):
            lines.append(f"camera.{name} = {value} was requested, the camera reports {report}")
    if applied.exposure_us is not None and requested.frame_rate_hz is not None:
        possible_hz = 1e6 / applied.exposure_us
        if min(requested.frame_rate_hz, applied.frame_rate_hz or math.inf) > 1.001 * possible_hz:
            lines.append(
                f"camera.frame_rate_hz = {requested.frame_rate_hz:g} was requested, "
                f"an exposure of {applied.exposure_us:g} µs leaves at most {possible_hz:g} Hz"
            )
    return lines


def check_full_scale(config: Configuration, info: CameraInfo, applied: CameraSettings) -> None:
    """Raise ConfigurationError if [sensor] states more than a pixel of this camera can hold."""
    # the full scale that a camera reports when opened may belong to its previous pixel format
    bits = re.search(r"\d+$", applied.pixel_format or "")
    max_dn = max(info.full_scale_dn, 2 ** int(bits[0]) - 1 if bits else 0)
    if config.sensor is not None and config.sensor.full_scale_dn > max_dn:
        raise ConfigurationError(
            f"sensor.full_scale_dn = {config.sensor.full_scale_dn:g}: the camera ends at {max_dn} DN; "
            "state that, or ask for more bits with camera.pixel_format"
        )


def shutter_of(config: Configuration) -> Shutter:
    """The effective shutter: global with a pulsed laser, because all rows see the light at the same time."""
    return GLOBAL if config.laser.pulse_us else config.shutter or GLOBAL


def shift_to_light_ns(config: Configuration, info: CameraInfo, applied: CameraSettings) -> int:
    """Shift of the camera's timestamps to the middle of the light, to be added to them.

    The middle of the light is that of the laser's pulse, or else of the first row's exposure. 0 for a camera
    without a clock, and if the shift depends on an exposure that is unknown.
    """
    stamp = config.camera.stamped or info.stamped
    exposure_us = applied.exposure_us
    if config.laser.pulse_us:
        middle_us = config.laser.pulse_delay_us + 0.5 * config.laser.pulse_us
    else:
        middle_us = 0.5 * (exposure_us or 0.0)
    if not info.has_clock or (exposure_us is None and (stamp != "start" or not config.laser.pulse_us)):
        return 0
    stamp_us = 0.0
    if stamp == "middle":
        stamp_us = 0.5 * (exposure_us or 0.0)
    elif stamp == "end":
        stamp_us = (exposure_us or 0.0) + 1e6 * _readout_s(config, info, applied)
    return round(1e3 * (middle_us - stamp_us))


def pulse_faults(config: Configuration, info: CameraInfo, applied: CameraSettings) -> list[str]:
    """Faults of the laser's pulses, which must lie in the time in which all rows are exposed."""
    laser = config.laser
    if not laser.pulse_us:
        return []
    faults = []
    end_us = laser.pulse_delay_us + laser.pulse_us
    if applied.exposure_us is not None and end_us > applied.exposure_us:
        faults.append(
            f"laser.pulse_us: the pulse ends {end_us:g} µs after the exposure begins, "
            f"which takes {applied.exposure_us:g} µs"
        )
    readout_us = 1e6 * _readout_s(config, info, applied)
    if laser.pulse_delay_us < readout_us:
        faults.append(
            f"laser.pulse_delay_us = {laser.pulse_delay_us:g}: "
            f"the last row is exposed from {readout_us:.0f} µs on"
        )
    return faults


def _readout_s(config: Configuration, info: CameraInfo, applied: CameraSettings) -> float:
    """Time between the exposures of the first and the last row."""
    rows = applied.height_px or info.height_px
    return (config.shutter or GLOBAL).row_time_s * (rows - 1)


SIMULATED_BALL = "simulated_ball"
SIMULATED_FLAT = "simulated_flat"
_AXES_KEYS = "slow_angle_rad", "non_orthogonality_rad", "mirrored"


def fill_from_truth(config: Configuration) -> Configuration:
    """Fill sensor, shutter, lever, axes, pendulum, materials and balance if they are not stated.

    The calibration is then perfect: ``--set simulation...`` changes the simulated apparatus and the
    values that the analysis uses for it together. The parameters of the contact are never passed on.
    """
    truth = config.simulation
    return config.model_copy(
        update={
            "sensor": config.sensor or _sensor(truth, config.camera),
            "shutter": config.shutter or _shutter(truth, config.camera.binning or 1),
            "lever": config.lever or _lever(truth, config.camera),
            "axes": config.axes or Axes(**{name: getattr(truth.axes, name) for name in _AXES_KEYS}),
            "pendulum": config.pendulum or _pendulum(truth),
            "materials": {**_materials(truth), **config.materials},
            "balance": _balance(truth, config.balance),
        }
    )


def _sensor(truth: SimulationSettings, camera: CameraSettings) -> SensorModel:
    pixel_format, binning = camera.pixel_format or f"mono{truth.sensor.bit_depth}", camera.binning or 1
    bit_depth = int(pixel_format.removeprefix("mono"))
    sensor_state = truth.sensor.at(bit_depth, camera.gain_db or 0.0).binned(binning)
    return SensorModel(
        gain_e_per_dn=sensor_state.gain_e_per_dn,
        read_noise_e=sensor_state.read_noise_e,
        full_scale_dn=sensor_state.full_scale_dn,
        pedestal_dn=sensor_state.black_level_dn,
        prnu=truth.sensor.prnu / binning,
    )


def _shutter(truth: SimulationSettings, binning: int) -> Shutter | None:
    """The rolling shutter; None for a global one, which needs no correction."""
    sensor = truth.sensor
    return Shutter(sensor.row_time_s * binning, first_row=sensor.first_row) if sensor.row_time_s else None


def _lever(truth: SimulationSettings, camera: CameraSettings) -> Lever:
    optics, sensor, binning = truth.optics, truth.sensor, camera.binning or 1

    def in_frame(
        place_px: float | None, size_px: int, offset_px: int | None, region_px: int | None
    ) -> float | None:
        """Place in the frame, in pixels of the sensor; None for the middle of a frame of the whole sensor."""
        if place_px is None and region_px is None:
            return None
        return (0.5 * (size_px - 1) if place_px is None else place_px) - binning * (offset_px or 0)

    return Lever(
        arm_m=optics.arm_m,
        u_arm_m=truth.stated.u_arm_m,
        pixel_pitch_m=sensor.pixel_pitch_m,
        u_pixel_pitch_m=truth.stated.u_pixel_pitch_m,
        reference_x_px=in_frame(optics.reference_x_px, sensor.width_px, camera.offset_x_px, camera.width_px),
        reference_y_px=in_frame(
            optics.reference_y_px, sensor.height_px, camera.offset_y_px, camera.height_px
        ),
    )


def _pendulum(truth: SimulationSettings) -> PendulumSettings:
    contact, stated = truth.contact, truth.stated
    return PendulumSettings(
        mass_kg=contact.mass_kg,
        u_mass_kg=stated.u_mass_kg,
        ball_radius_m=contact.ball_radius_m,
        u_ball_radius_m=stated.u_ball_radius_m,
        contact_radius_m=contact.contact_radius_m,
        ball_material=SIMULATED_BALL,
        flat_material=SIMULATED_FLAT,
        gravity_m_per_s2=contact.gravity_m_per_s2,
        u_gravity_m_per_s2=stated.u_gravity_m_per_s2,
    )


def _balance(truth: SimulationSettings, balance: BalanceSettings) -> BalanceSettings:
    """The balance with the inertia about the contact that gives the true period, and the elasticity."""
    if balance.inertia_kg_m2 is not None:
        return balance
    contact = truth.contact
    stiffness_n_m = contact.mass_kg * contact.gravity_m_per_s2 * contact.ball_radius_m
    inertia_kg_m2 = stiffness_n_m * (contact.period0_s / (2.0 * math.pi)) ** 2
    return replace(balance, inertia_kg_m2=inertia_kg_m2, gamma_pa=contact.gamma_pa, n=contact.n)


def _materials(truth: SimulationSettings) -> dict[str, Material]:
    contact, stated = truth.contact, truth.stated
    return {
        SIMULATED_BALL: Material(
            contact.ball_youngs_modulus_pa,
            contact.ball_poisson_ratio,
            stated.u_ball_youngs_modulus_pa,
            stated.u_poisson_ratio,
        ),
        SIMULATED_FLAT: Material(
            contact.flat_youngs_modulus_pa,
            contact.flat_poisson_ratio,
            stated.u_flat_youngs_modulus_pa,
            stated.u_poisson_ratio,
        ),
    }


def complete(config: Configuration) -> Configuration:
    """The configuration with missing sections from calibration files and true values of a simulated rig.

    The lever becomes that of the camera's binning and colour plane.
    """
    config = fill_from_files(_binned(config))
    return _binned(fill_from_truth(config)) if config.simulated else config


def _binned(config: Configuration) -> Configuration:
    if config.lever is None:
        return config
    return config.model_copy(update={"lever": config.lever.with_binning(config.camera.pitch_factor)})


_log = logging.getLogger(__name__)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_MAX_SUCCESSIVE_FAILURES = 10
"""Successive failures after which an observer is not called any more, because each failure costs time."""


class ObserverGuard:
    """Calls observers (display, view, notices, forecast, live fit, balance) so that their errors end no run.

    It may be used from several threads.
    """

    def __init__(self) -> None:
        self.failures: Counter[str] = Counter()
        """Number of failures by the observer's name."""
        self._successive_failures: Counter[str] = Counter()
        self._news: list[str] = []

    def call(
        self,
        name: str,
        default: Result,
        call: Callable[Arguments, Result],
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Result:
        """The value of a call; `default` if it raises an Exception, or is not made any more."""
        if self._successive_failures[name] >= _MAX_SUCCESSIVE_FAILURES:
            return default
        try:
            result = call(*args, **kwargs)
        except Exception as error:
            self.failures[name] += 1
            self._successive_failures[name] += 1
            reason = f"{type(error).__name__}: {error}".splitlines()[0].rstrip(": ")
            if self.failures[name] == 1:
                _log.exception("%s has failed, the run goes on", name)
                self._news.append(f"{name} has failed, the run goes on: {reason}")
            if self._successive_failures[name] == _MAX_SUCCESSIVE_FAILURES:
                self._news.append(f"{name} is left out after {_MAX_SUCCESSIVE_FAILURES} failures in a row")
            return default
        self._successive_failures[name] = 0
        return result

    def take_news(self) -> list[str]:
        """Texts for the log since the last call."""
        news, self._news = self._news, []
        return news

    @property
    def text(self) -> str:
        """Numbers of failures by observer, as text; empty without failures."""
        return ", ".join(f"{name} {count} times" for name, count in sorted(self.failures.items()))
