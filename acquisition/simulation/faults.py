"""Faults that a simulated rig can suffer at stated times."""

from pydantic import BaseModel, Field


class FaultSettings(BaseModel, frozen=True, extra="forbid"):
    """When what goes wrong, in seconds since the start of each run; None: never.

    All are carried out by the simulated camera.
    """

    laser_fades_at_s: float | None = Field(default=None, ge=0)
    laser_fade_duration_s: float = Field(default=5.0, gt=0, description="dark half of it, then back again")
    laser_fade_to: float = Field(default=0.0, ge=0, le=1, description="what is left of the power")
    camera_unplugged_at_s: float | None = Field(default=None, ge=0)
    camera_replugged_at_s: float | None = Field(default=None, ge=0, description="None: never again")
    frames_stalled_at_s: float | None = Field(default=None, ge=0, description="the camera falls silent")
    frames_stalled_duration_s: float = Field(default=2.0, gt=0)
    vibration_burst_at_s: float | None = Field(default=None, ge=0)
    vibration_burst_duration_s: float = Field(default=3.0, gt=0)
    vibration_burst_arcsec: float = Field(default=2.0, gt=0, description="largest amplitude, both axes")
    vibration_burst_hz: float = Field(default=17.0, gt=0)
    draught_at_s: float | None = Field(default=None, ge=0, description="a push of both modes")
    draught_arcsec: float = Field(default=3.0, description="swing that the push would give at rest")
