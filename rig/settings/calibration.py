"""[calibration]: the files in use; [timebase]: the section that the clock's file fills."""

from pathlib import Path

from pydantic import BaseModel, Field


class CalibrationSettings(BaseModel, frozen=True, extra="forbid"):
    """Calibration files in use; each fills a section that is then not stated. Paths from where rig is run."""

    sensor: Path | None = Field(default=None, description="fills [sensor]")
    lever: Path | None = Field(default=None, description="fills [lever]")
    axes: Path | None = Field(default=None, description="fills [axes]")
    clock: Path | None = Field(default=None, description="fills [timebase]")
    pointing: Path | None = Field(default=None, description="kept with the record")
    checks: tuple[Path, ...] = Field(default=(), description="known-angle checks before and after the series")


class TimebaseSettings(BaseModel, frozen=True, extra="forbid"):
    """The camera's clock against true time."""

    camera_rate: float = Field(
        default=1.0, gt=0.9, lt=1.1, description="true seconds per second of the camera"
    )
    u_camera_rate: float = Field(default=0.0, ge=0)
