"""Section [laser]: the driver, power or current, and limits; with the registry of the drivers."""

from typing import Literal, Self

from pydantic import BaseModel, Field, field_validator, model_validator

LASERS: dict[str, str] = {
    "thorlabs4000": "rig.control.lasers.thorlabs4000:Thorlabs4000",
    "obis": "rig.control.lasers.obis:Obis",
    "ldc500": "rig.control.lasers.ldc500:Ldc500",
    "cobolt": "rig.control.lasers.cobolt:Cobolt",
}
"""Registry of the laser drivers: the values of ``laser.kind``, and the class of each.

A driver is added by one line here and one file with a subclass of `SerialLaser` (serial_laser.py), which is
imported when it is used.
"""


class LaserSettings(BaseModel, frozen=True, extra="forbid"):
    """The laser: its driver, limit and setting of power or current, and warm-up time.

    Controllers of laser diodes are set in amperes, whole lasers in watts. `power_w` or `current_a` above its
    limit is rejected here, before anything is opened.
    """

    kind: str = "none"
    port: str = ""
    baud: int = Field(default=115200, gt=0)
    timeout_s: float = Field(default=0.5, gt=0, le=5)
    max_power_w: float = Field(default=0.001, ge=0, le=1, allow_inf_nan=False)
    power_w: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    interlock: Literal["own", "controller"] = "own"
    """Whether the interlock of a laser with a port of its own is wired through the controller's enable relay,
    whose watchdog then switches the laser off.
    """
    max_current_a: float = Field(default=0.0, ge=0, le=20, allow_inf_nan=False)
    current_a: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    pulse_us: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        description="light only for this time in each exposure; 0: all the time (controller)",
    )
    pulse_delay_us: float = Field(
        default=0.0, ge=0, le=1e6, description="from the beginning of an exposure to that of its pulse"
    )
    when_dark: Literal["end", "wait"] = Field(
        default="wait",
        description="'wait': a run whose laser goes dark waits until the person at the terminal or rig desk "
        "acknowledges the trip and asks for light, and ends where nobody sits; 'end': it ends",
    )
    warm_up_min_s: float = Field(default=0.0, ge=0)
    warm_up_max_s: float = Field(default=1800.0, gt=0)

    @field_validator("kind")
    @classmethod
    def _check_kind(cls, kind: str) -> str:
        if kind not in (kinds := ("none", "controller", *LASERS)):
            raise ValueError(f"unknown laser; choose one of {', '.join(kinds)}")
        return kind

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        if self.kind in LASERS and not self.port:
            raise ValueError("port is missing; name the laser's serial port (or usbtmc), or see `rig doctor`")
        if self.power_w > self.max_power_w:
            raise ValueError(
                f"power_w = {self.power_w:g} W is above max_power_w = {self.max_power_w:g} W; lower it, or "
                "raise the limit if the laser's class allows it"
            )
        if self.current_a > self.max_current_a:
            raise ValueError(f"current_a {self.current_a:g} is above max_current_a {self.max_current_a:g}")
        if self.pulse_us and self.kind != "controller":
            raise ValueError(
                f"pulse_us needs kind = 'controller', whose gate makes the pulses, not {self.kind!r}"
            )
        if 0 < self.pulse_us < 1:
            raise ValueError(f"pulse_us {self.pulse_us:g} is too short; at least 1 us is possible")
        if self.warm_up_min_s > self.warm_up_max_s:
            raise ValueError(
                f"warm_up_min_s {self.warm_up_min_s:g} is above warm_up_max_s {self.warm_up_max_s:g}"
            )
        return self
