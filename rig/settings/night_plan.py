"""The plan of a night: series to be measured one after the other, each with its conditions."""

from pathlib import Path
from typing import Self

from pydantic import BaseModel, Field, model_validator

from processing.errors import ConfigurationError
from rig.settings.run_conditions import RunConditions
from rig.settings.toml_file import read_toml
from rig.settings.wording import validated


class PlannedSeries(RunConditions, frozen=True, extra="forbid"):
    """One series: a configuration, changes to it, and when its runs may begin."""

    name: str = Field(pattern=r"^\w[\w.-]*$", description="of its folder")
    config: Path
    runs: int | None = Field(default=None, ge=1, le=1000)
    set: tuple[str, ...] = Field(default=(), description="KEY=VALUE, as with --set")
    repeat_bad: int = Field(default=0, ge=0, description="most runs repeated because of their conditions")
    pause_s: float = Field(default=0.0, ge=0, description="after the series")

    def overrides(self) -> list[str]:
        """Changes of the configuration that follow from the plan."""
        changes = list(self.set)
        if self.runs is not None:
            changes.append(f"session.runs={self.runs}")
        return [*changes, *self.limits()]


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
