"""Sections of the configuration: instrument, balance, calibration files, preflight, phases, start, camera."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, create_model, field_validator, model_validator
from pydantic.dataclasses import dataclass

from acquisition.camera import CameraSettings, TimestampMoment
from acquisition.cameras.drivers import DRIVERS, default_settings, settings_models, unknown_driver
from processing.balance import BalanceLimits
from processing.errors import ConfigurationError
from processing.instruments import DEGREE_RAD, INSTRUMENTS, Description, Limits

_Value = TypeVar("_Value", float, float | None)


class InstrumentSettings(BaseModel, frozen=True, extra="forbid"):
    """The instrument. `kind` selects a description (see `rig init --instruments`); other keys change it."""

    kind: str = "single_ball"
    mass_kg: float | None = Field(
        default=None,
        gt=0,
        lt=100,
        description="as weighed; compared with the limits of the standard, if it has any",
    )
    support_radius_m: float | None = Field(default=None, gt=0, lt=1, description="ball, roller or axis")
    u_support_radius_m: float = Field(default=0.0, ge=0)
    lever_m: float | None = Field(
        default=None, gt=0, description="distance of the mass centre from the axis of rotation"
    )
    u_lever_m: float = Field(default=0.0, ge=0)
    start_amplitude_deg: float | None = Field(default=None, gt=0, lt=90)
    end_amplitude_deg: float | None = Field(default=None, gt=0, lt=90)
    period_s: float | None = Field(default=None, gt=0, description="required by the standard on glass")
    period_tolerance_s: float | None = Field(default=None, gt=0)
    glass_time_s: float | None = Field(default=None, gt=0, description="damping time required on glass")
    glass_tolerance_s: float | None = Field(default=None, gt=0)
    glass_time_at_least: bool = Field(default=False, description="glass_time_s is only a lower limit")
    temperature_c: float | None = Field(default=None, gt=-100, lt=200)
    temperature_tolerance_c: float | None = Field(default=None, gt=0)
    humidity_percent: float | None = Field(default=None, ge=0, le=100)
    humidity_tolerance_percent: float | None = Field(default=None, gt=0)
    scale_divisions: float = Field(default=100.0, gt=0, description="length of Herbert's scale")
    reference_runs: tuple[int, ...] = Field(
        default=(), description="numbers, from 1, of the runs on glass or on the reference sample"
    )
    reference_time_s: float | None = Field(
        default=None, gt=0, description="damping time of the reference if it was measured elsewhere"
    )
    u_reference_time_s: float = Field(default=0.0, ge=0)

    @field_validator("kind")
    @classmethod
    def _check_kind(cls, kind: str) -> str:
        if kind not in INSTRUMENTS:
            raise ValueError(f"unknown instrument; choose one of {', '.join(INSTRUMENTS)}")
        return kind

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        description = self.description()
        if not description.end_amplitude_rad < description.start_amplitude_rad:
            raise ValueError(
                f"instrument: end_amplitude_deg = {description.end_amplitude_rad / DEGREE_RAD:g} must be "
                f"below start_amplitude_deg = {description.start_amplitude_rad / DEGREE_RAD:g}"
            )
        if any(number < 1 for number in self.reference_runs):
            raise ValueError(f"instrument.reference_runs = {list(self.reference_runs)}: runs count from 1")
        return self

    def description(self) -> Description:
        """The built-in description with the values overridden here."""
        builtin = INSTRUMENTS[self.kind]
        tolerance = math.inf if self.glass_time_at_least else self.glass_tolerance_s
        return replace(
            builtin,
            support_radius_m=_value_or(self.support_radius_m, builtin.support_radius_m),
            lever_m=_value_or(self.lever_m, builtin.lever_m),
            start_amplitude_rad=_value_or(self.start_amplitude_deg, builtin.start_amplitude_rad, DEGREE_RAD),
            end_amplitude_rad=_value_or(self.end_amplitude_deg, builtin.end_amplitude_rad, DEGREE_RAD),
            period_s=_limits(builtin.period_s, self.period_s, self.period_tolerance_s),
            glass_time_s=_limits(builtin.glass_time_s, self.glass_time_s, tolerance),
            temperature_c=_limits(builtin.temperature_c, self.temperature_c, self.temperature_tolerance_c),
            humidity_percent=_limits(
                builtin.humidity_percent, self.humidity_percent, self.humidity_tolerance_percent
            ),
        )


def _value_or(value: float | None, default: _Value, unit: float = 1.0) -> float | _Value:
    return default if value is None else value * unit


def _limits(builtin: Limits | None, value: float | None, tolerance: float | None) -> Limits | None:
    """The built-in limits with the given values; if there are none, a value needs a tolerance as well."""
    if builtin is None:
        return None if value is None or tolerance is None else Limits(value, tolerance)
    return Limits(_value_or(value, builtin.value), _value_or(tolerance, builtin.tolerance))


class WeightSettings(BaseModel, frozen=True, extra="forbid"):
    """A trimming weight on a screw; at `sense` -1 a clockwise turn moves it in the negative direction.

    A `mass_kg` or a `sense` of 0 means that it is not known.
    """

    mass_kg: float = Field(default=0.002, ge=0)
    pitch_m: float = Field(default=0.5e-3, gt=0, description="pitch of the thread")
    sense: int = Field(default=1, ge=-1, le=1)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BalanceSettings(BalanceLimits):
    """Balancing: limits, and properties of the weights. `rig balance` learns the effect of a turn."""

    seconds: float = Field(
        default=30.0,
        gt=9,
        description="longest time of one measurement, which ends after six periods, once the spin is known",
    )
    inertia_kg_m2: float | None = Field(
        default=None, gt=0, description="about the contact; needed for the height of mass centre"
    )
    u_effect: float = Field(
        default=1.0,
        gt=0,
        le=2,
        description="relative uncertainty of the effect of a turn as computed from mass and thread; at 1 a "
        "weight may be 3 times as strong or on the other axis; 0.2 if the drawing is trusted",
    )
    gamma_pa: float = Field(
        default=0.0, ge=0, description="elastic adhesion, to compute T0 from T; 0: T0 = T"
    )
    n: float = Field(default=0.1, ge=0, description="exponent of the elastic adhesion")
    weight_x: WeightSettings = WeightSettings()
    weight_y: WeightSettings = WeightSettings()
    weight_height: WeightSettings = WeightSettings(mass_kg=0.005, pitch_m=0.7e-3)


class CalibrationSettings(BaseModel, frozen=True, extra="forbid"):
    """Calibration files in use. Each replaces a section of this file, which is then left out.

    Relative paths start at the folder in which rig is run.
    """

    sensor: Path | None = Field(default=None, description="fills [sensor]")
    lever: Path | None = Field(default=None, description="fills [lever]")
    axes: Path | None = Field(default=None, description="fills [axes]")
    clock: Path | None = Field(default=None, description="fills [timebase]")
    shutter: Path | None = Field(default=None, description="fills [shutter]")
    air: Path | None = Field(
        default=None, description="fills fit.drag_s and its uncertainty, as rig calibrate air has measured it"
    )
    pointing: Path | None = Field(
        default=None, description="result of rig calibrate pointing, stored with the record"
    )
    checks: tuple[Path, ...] = Field(
        default=(), description="known-angle checks made before and after the series"
    )


class TimebaseSettings(BaseModel, frozen=True, extra="forbid"):
    """Rate of the camera's clock relative to true time."""

    camera_rate: float = Field(
        default=1.0, gt=0.9, lt=1.1, description="true seconds per second of the camera"
    )
    u_camera_rate: float = Field(default=0.0, ge=0)


StartWay = Literal["at once", "by hand", "magnet", "starter"]


class PreflightSettings(BaseModel, frozen=True, extra="forbid"):
    """Checks before a run, and their limits. 'auto': only if frames come in real time, not on demand."""

    when: Literal["auto", "always", "never"] = "auto"
    duration_s: float = Field(
        default=4.0, gt=0.5, le=600, description="of the measurement of the resting spot"
    )
    max_saturated_fraction: float = Field(
        default=0.01, ge=0, le=1, description="frames with a saturated spot"
    )
    max_lost_fraction: float = Field(default=0.01, ge=0, le=1, description="frames without a valid spot")
    max_poor_fit_fraction: float = Field(
        default=0.01, ge=0, le=1, description="spots that the beam's model does not fit: above, a warning"
    )
    min_peak_fraction: float = Field(default=0.15, ge=0, lt=1, description="peak of the spot / full scale")
    max_peak_fraction: float = Field(default=0.95, gt=0, le=1, description="peak of the spot / full scale")
    max_noise_arcsec: float = Field(default=0.1, gt=0, description="noise of one frame, at rest")
    max_vibration_arcsec: float = Field(default=0.2, gt=0, description="strongest line of the spectrum")
    max_rest_offset_arcsec: float = Field(
        default=60.0, gt=0, description="distance of the rest position from the reference"
    )
    max_clock_jitter_us: float = Field(default=100.0, gt=0, description="jitter of the frames' timestamps")
    max_frame_rate_error: float = Field(
        default=0.02, gt=0, description="relative deviation from the requested rate"
    )
    max_dropped_fraction: float = Field(default=0.001, ge=0, le=1)
    max_ground_rad_per_s2_rthz: float | None = Field(
        default=None, gt=0, description="drive of the resting pendulum, seen in duration_s; default: any"
    )
    min_temperature_c: float = 5.0
    max_temperature_c: float = 40.0
    min_humidity_percent: float = Field(default=0.0, ge=0, le=100)
    max_humidity_percent: float = Field(default=100.0, ge=0, le=100)
    wait_max_s: float = Field(
        default=0.0, ge=0, description="longest total wait after a no-go, with the laser dark"
    )
    try_every_s: float = Field(default=300.0, gt=0, description="time between tries during that wait")


class PhaseSettings(BaseModel, frozen=True, extra="forbid"):
    """Limits of the phases before the release; times are those of the frames' timestamps."""

    rest_limit_arcsec: float = Field(default=1.0, gt=0, description="half the range of X and Y at rest")
    rest_window_s: float = Field(default=5.0, gt=0, description="time at rest; longer than a period")
    rest_max_s: float = Field(default=900.0, gt=0)
    warm_up_drift_arcsec_per_min: float = Field(
        default=1.0, gt=0, description="warm-up ends below this drift"
    )
    warm_up_window_s: float = Field(default=20.0, gt=2, description="time over which the drift is determined")
    release_max_s: float = Field(default=300.0, gt=0, description="time allowed for the release")


class StartSettings(BaseModel, frozen=True, extra="forbid"):
    """How a run starts. 'at once' records from the first frame, whether or not the pendulum moves."""

    way: StartWay = Field(
        default="at once",
        description="'by hand': the operator releases the pendulum; 'magnet', 'starter': the controller does",
    )
    pretrigger_s: float = Field(default=2.0, gt=0, le=30, description="recorded time before the release")
    trigger_arcsec: float = Field(default=5.0, gt=0, description="a motion larger than this is the release")
    lowest_amplitude: float = Field(default=0.9, gt=0, description="first / wanted amplitude, at least")
    highest_amplitude: float = Field(default=1.5, gt=0, description="first / wanted amplitude, at most")
    max_transverse_ratio: float = Field(default=0.05, gt=0, description="fast amplitude / slow amplitude")
    attempts: int = Field(default=3, ge=1, le=100)
    patience_s: float = Field(
        default=40.0, gt=0, description="time allowed for two clean half-cycles and a balance"
    )
    starter_pulse_s: float = Field(default=0.6, gt=0, description="first pulse; adjusted after each attempt")

    @property
    def by_controller(self) -> bool:
        """Whether the controller starts the pendulum."""
        return self.way in ("magnet", "starter")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.lowest_amplitude >= self.highest_amplitude:
            raise ValueError(
                f"lowest_amplitude {self.lowest_amplitude:g} must be below "
                f"highest_amplitude {self.highest_amplitude:g}"
            )
        return self


class CameraChoice(CameraSettings, frozen=True, extra="forbid"):
    """The choice of the camera, and the settings requested from it."""

    driver: str = Field(description=f"one of {', '.join(DRIVERS)}; simulated invents its numbers")
    serial: str | None = Field(default=None, description="needed only if several cameras are plugged in")
    timeout_s: float = Field(
        default=5.0,
        gt=0,
        description="the camera counts as stalled after this time without a frame, or two frame times",
    )

    stamped: TimestampMoment | None = Field(
        default=None,
        description="moment of the exposure that the timestamps mark; None: as the driver knows it",
    )

    @field_validator("driver")
    @classmethod
    def _check_driver(cls, driver: str) -> str:
        if driver not in DRIVERS:
            raise ValueError(unknown_driver())
        return driver

    @property
    def patience_s(self) -> float:
        """Time without a frame after which the camera counts as stalled; a slow one gets two frame times."""
        return max(self.timeout_s, 0.5 + 2 / self.frame_rate_hz if self.frame_rate_hz else 0.0)

    def driver_settings(self) -> BaseModel:
        """Section ``[camera.NAME]`` of the chosen driver; its serial number defaults to ``camera.serial``.

        Raises ConfigurationError if a section without defaults is missing, or for a serial number of a
        driver that has none.
        """
        section: BaseModel | None = getattr(self, self.driver)
        if section is None:
            (model,) = settings_models(self.driver)
            key = next(name for name, field in model.model_fields.items() if field.is_required())
            raise ConfigurationError(
                f"camera.driver = {self.driver!r} needs [camera.{self.driver}] with a {key}: "
                f"--set camera.{self.driver}.{key}=VALUE"
            )
        if self.serial is None or getattr(section, "serial", None) is not None:
            return section
        if "serial" not in type(section).model_fields:
            raise ConfigurationError(
                f"camera.serial = {self.serial!r}: {self.driver!r} has no serial numbers; leave it out"
            )
        return section.model_copy(update={"serial": self.serial})


# The sections are made from the registry, so a type checker cannot see them; code uses `driver_settings`.
if TYPE_CHECKING:
    CameraSection = CameraChoice
else:

    def _sections() -> dict[str, Any]:
        sections = {}
        for name, driver in DRIVERS.items():
            if not driver.sections:
                (model,) = settings_models(name)
                default = default_settings(model)
                sections[name] = (model | None, None) if default is None else (model, default)
        return sections

    CameraSection = create_model(
        "CameraSection",
        __base__=CameraChoice,
        __module__=__name__,
        __doc__=CameraChoice.__doc__,
        **_sections(),
    )
