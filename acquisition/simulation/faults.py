"""Section [faults]: faults of the simulated rig at stated times."""

from pydantic import BaseModel, Field


class FaultSettings(BaseModel, frozen=True, extra="forbid"):
    """Faults of the simulated rig; times are in seconds since the start of each run, None means never."""

    laser_fades_at_s: float | None = Field(default=None, ge=0)
    laser_fade_duration_s: float = Field(default=5.0, gt=0, description="at the lowest power for half of it")
    laser_fade_to: float = Field(default=0.0, ge=0, le=1, description="lowest power, relative")
    camera_unplugged_at_s: float | None = Field(default=None, ge=0)
    camera_replugged_at_s: float | None = Field(default=None, ge=0, description="None: never")
    frames_stalled_at_s: float | None = Field(default=None, ge=0, description="no frames from then on")
    frames_stalled_duration_s: float = Field(default=2.0, gt=0)
    clock_zero_at_s: float | None = Field(
        default=None, ge=0, description="in real time, one frame has the time 0"
    )
    clock_steps_at_s: float | None = Field(
        default=None, ge=0, description="in real time, the camera's clock steps"
    )
    clock_step_s: float = Field(default=0.13, description="by so much, forward")
    clock_bits: int | None = Field(
        default=None, ge=32, le=62, description="of its counter of ns, which begins again at 0 beyond them"
    )
    vibration_burst_at_s: float | None = Field(default=None, ge=0)
    vibration_burst_duration_s: float = Field(default=3.0, gt=0)
    vibration_burst_arcsec: float = Field(default=2.0, gt=0, description="largest amplitude, both axes")
    vibration_burst_hz: float = Field(default=17.0, gt=0)
    draught_at_s: float | None = Field(default=None, ge=0, description="an impulse on both modes")
    draught_arcsec: float = Field(default=3.0, description="amplitude that the impulse gives at rest")
    interlock_opens_at_s: float | None = Field(
        default=None, ge=0, description="of the simulated controller, since it first lit the laser"
    )
    interlock_open_for_s: float = Field(default=3.0, gt=0)
