"""Sections [calibration], the calibration files in use, and [timebase], filled by the clock's file."""

from pathlib import Path

from pydantic import BaseModel, Field


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
