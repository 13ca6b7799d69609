"""The plan of a night: series to be measured one after the other, each with its conditions."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, Field, model_validator

from processing.errors import ConfigurationError
from rig.settings.configuration_file import read_toml
from rig.settings.wording import validated


def _rising(band: tuple[float, float]) -> tuple[float, float]:
    if band[0] >= band[1]:
        raise ValueError(f"{list(band)}: its first value should be the smaller one")
    return band


_Band = Annotated[tuple[float, float], AfterValidator(_rising)]


class PlannedSeries(BaseModel, frozen=True, extra="forbid"):
    """One series: a configuration, changes to it, and when its runs may begin.

    A run begins only while all conditions are met; they are limits of its preflight.
    """

    name: str = Field(pattern=r"^\w[\w.-]*$", description="of its folder")
    config: Path
    runs: int | None = Field(default=None, ge=1, le=1000)
    set: tuple[str, ...] = Field(default=(), description="KEY=VALUE, as with --set")
    repeat_bad: int = Field(default=0, ge=0, description="most runs repeated because of their conditions")
    pause_s: float = Field(default=0.0, ge=0, description="after the series")
    temperature_c: _Band | None = Field(
        default=None, description="a run begins only while the air is between"
    )
    humidity_percent: _Band | None = Field(
        default=None, description="a run begins only while the air is between"
    )
    quiet_arcsec: float | None = Field(
        default=None, gt=0, description="a run begins only while the resting spot vibrates less"
    )
    ground_rad_per_s2_rthz: float | None = Field(
        default=None, gt=0, description="a run begins only while the ground drives the pendulum less"
    )
    wait_max_s: float = Field(default=7200.0, ge=0, description="in all; then it is given up")
    try_every_s: float = Field(default=300.0, gt=0)

    def overrides(self) -> list[str]:
        """Changes of the configuration that follow from the plan."""
        changes = list(self.set)
        if self.runs is not None:
            changes.append(f"session.runs={self.runs}")
        return [*changes, *self._limits()]

    @property
    def asks_the_air(self) -> bool:
        """Whether they need a sensor of the air."""
        return self.temperature_c is not None or self.humidity_percent is not None

    @property
    def asks_the_rest(self) -> bool:
        """Whether they need a look at the resting pendulum."""
        return self.quiet_arcsec is not None or self.ground_rad_per_s2_rthz is not None

    def _limits(self) -> list[str]:
        """Changes of the configuration, as with --set."""
        changes = []
        for name in ("temperature_c", "humidity_percent"):
            if (band := getattr(self, name)) is not None:
                changes += [f"preflight.min_{name}={band[0]}", f"preflight.max_{name}={band[1]}"]
        if self.quiet_arcsec is not None:
            changes.append(f"preflight.max_vibration_arcsec={self.quiet_arcsec}")
        if self.ground_rad_per_s2_rthz is not None:
            changes.append(f"preflight.max_ground_rad_per_s2_rthz={self.ground_rad_per_s2_rthz}")
        return [*changes, 'preflight.when="always"'] if changes else []


class NightPlan(BaseModel, frozen=True, extra="forbid"):
    """The whole file."""

    series: tuple[PlannedSeries, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [series.name for series in self.series]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two series are called {twice!r}; each needs a folder of its own")
        return self


def load_plan(path: Path) -> NightPlan:
    """Read a plan; configurations are relative to its folder. One line of error names every fault."""
    plan, faults = validated(NightPlan, read_toml(path, "plan"))
    if plan is None:
        raise ConfigurationError(f"{path}: {'; '.join(fault.line for fault in faults)}")
    return NightPlan(
        series=tuple(
            series.model_copy(update={"config": path.parent / series.config}) for series in plan.series
        )
    )
