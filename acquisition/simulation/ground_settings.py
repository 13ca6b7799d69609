"""Sections [simulation.ground] and [simulation.person]: what moves the base of the simulated pendulum."""

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, Field, model_validator


class GroundTruth(BaseModel, frozen=True, extra="forbid"):
    """Motion of the ground: horizontal acceleration, through the mass centre's height, and tilt.

    The two horizontal components, along the slow and the fast swing, are independent and equal in
    level. A file's first column of accelerations moves the slow mode, its second the fast one.
    """

    model: Literal["none", "white", "peterson", "file"] = Field(
        default="none",
        description="of the acceleration: 'white' as stated below; 'peterson': between the new low and high "
        "noise models of 1993; 'file': as recorded",
    )
    white_m_per_s2_per_sqrt_hz: float = Field(
        default=1e-6, ge=0, description="white level, one-sided amplitude spectral density"
    )
    between_noise_models: float = Field(
        default=0.5, ge=0, le=1, description="place in dB between the low (0) and the high (1) noise model"
    )
    above_low_noise_db: float | None = Field(
        default=None, gt=-100, lt=200, description="instead: so many dB above the low noise model"
    )
    file: Path | None = Field(
        default=None,
        description="CSV of time_s and one or two accelerations at even times; a column's name ends in its "
        "unit: _m_per_s2, _um_per_s2 or _nm_per_s2",
    )
    file_offset_s: float = Field(default=0.0, ge=0, description="place in the file at which a run begins")
    tilt_rad_per_sqrt_hz: float = Field(
        default=0.0, ge=0, description="tilt of the base: white level, one-sided, with any model"
    )
    tilt_slow_arcsec_per_min: float = Field(
        default=0.0, description="steady tilt of the base along the slow swing, as of one that settles"
    )
    tilt_fast_arcsec_per_min: float = 0.0
    tilt_step_at_s: float | None = Field(default=None, ge=0, description="someone steps beside the base")
    tilt_step_slow_arcsec: float = Field(default=0.0, description="from then on; it takes a second")
    tilt_step_fast_arcsec: float = 0.0
    mass_centre_height_m: float = Field(
        default=2e-4, ge=-1, le=1, description="of the pendulum over the point of contact; below it: negative"
    )
    bandwidth_hz: float = Field(
        default=5.0, gt=0, le=200, description="the spectrum holds up to here, well above both modes"
    )
    seed: int = Field(
        default=0, ge=0, lt=2**31, description="another one: other ground, all other noise as before"
    )

    @property
    def base_tilts(self) -> bool:
        """Whether the base ever tilts."""
        steady = self.tilt_slow_arcsec_per_min, self.tilt_fast_arcsec_per_min
        return self.tilt_rad_per_sqrt_hz > 0 or any(steady) or self.tilt_step_at_s is not None

    @model_validator(mode="after")
    def _file_is_named(self) -> Self:
        if self.model == "file" and self.file is None:
            raise ValueError("ground.model = 'file' needs ground.file, a CSV file of accelerations")
        return self


class SeismometerTruth(BaseModel, frozen=True, extra="forbid"):
    """An instrument beside the rig that feels the ground; for witness.kind = 'simulated'."""

    rate_hz: float = Field(default=20.0, gt=0, le=1000, description="of its samples")
    counts_per_m_per_s2: float = Field(default=1e9, gt=0, description="what it writes")
    noise_m_per_s2_per_sqrt_hz: float = Field(
        default=1e-10, ge=0, description="of its own: white level, one-sided"
    )
    delay_s: float = Field(default=0.0, ge=0, le=10, description="by which it is late")


class PersonTruth(BaseModel, frozen=True, extra="forbid"):
    """A person who walks by: bursts of ground acceleration in step, from a direction drawn for each."""

    passes_at_s: tuple[float, ...] = Field(default=(), description="begin of each pass, seconds into a run")
    passes_per_hour: float = Field(
        default=0.0, ge=0, le=3600, description="mean of further ones at random times"
    )
    duration_s: float = Field(default=10.0, gt=0, le=600, description="of a pass; nearest in its middle")
    acceleration_m_per_s2: float = Field(default=1e-4, ge=0, le=1, description="largest")
    steps_per_s: float = Field(default=1.8, gt=0, le=20, description="frequency of the shaking")

    @property
    def passes(self) -> bool:
        """Whether anyone ever does."""
        return bool(self.passes_at_s) or self.passes_per_hour > 0
