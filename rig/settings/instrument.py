"""Section [instrument]: the kind of pendulum, and values that replace those of its description."""

import math
from dataclasses import replace
from typing import Self, TypeVar

from pydantic import BaseModel, Field, field_validator, model_validator

from processing.instruments import DEGREE_RAD, INSTRUMENTS, Description, Limits

_Value = TypeVar("_Value", float, float | None)


class InstrumentSettings(BaseModel, frozen=True, extra="forbid"):
    """`kind` selects a description (see `rig init --instruments`); a key left out keeps its value."""

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
    def _described(cls, kind: str) -> str:
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
        table = INSTRUMENTS[self.kind]
        tolerance = math.inf if self.glass_time_at_least else self.glass_tolerance_s
        return replace(
            table,
            support_radius_m=_stated(self.support_radius_m, table.support_radius_m),
            lever_m=_stated(self.lever_m, table.lever_m),
            start_amplitude_rad=_stated(self.start_amplitude_deg, table.start_amplitude_rad, DEGREE_RAD),
            end_amplitude_rad=_stated(self.end_amplitude_deg, table.end_amplitude_rad, DEGREE_RAD),
            period_s=_limits(table.period_s, self.period_s, self.period_tolerance_s),
            glass_time_s=_limits(table.glass_time_s, self.glass_time_s, tolerance),
            temperature_c=_limits(table.temperature_c, self.temperature_c, self.temperature_tolerance_c),
            humidity_percent=_limits(
                table.humidity_percent, self.humidity_percent, self.humidity_tolerance_percent
            ),
        )


def _stated(value: float | None, otherwise: _Value, unit: float = 1.0) -> float | _Value:
    return otherwise if value is None else value * unit


def _limits(table: Limits | None, value: float | None, tolerance: float | None) -> Limits | None:
    """The built-in limits with the given values; if there are none, a value needs a tolerance as well."""
    if table is None:
        return None if value is None or tolerance is None else Limits(value, tolerance)
    return Limits(_stated(value, table.value), _stated(tolerance, table.tolerance))
