"""Sections [preflight], [phases] and [start]: checks and phases before a run, and how it starts."""

from typing import Literal, Self

from pydantic import BaseModel, Field, model_validator

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
    min_peak_fraction: float = Field(default=0.15, ge=0, lt=1, description="peak of the spot over full scale")
    max_peak_fraction: float = Field(default=0.95, gt=0, le=1, description="peak of the spot over full scale")
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
    lowest_amplitude: float = Field(default=0.9, gt=0, description="first amplitude over the wanted one")
    highest_amplitude: float = Field(default=1.5, gt=0, description="first amplitude over the wanted one")
    max_transverse_ratio: float = Field(default=0.05, gt=0, description="amplitude of fast over slow mode")
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
