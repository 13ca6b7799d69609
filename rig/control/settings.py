"""Sections [controller], [environment_sensor] and [seismometer]."""

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, model_validator

ControllerKind = Literal["none", "simulated", "serial"]
EnvironmentKind = Literal["none", "controller", "serial"]

_QUANTITIES = frozenset({"temperature_c", "humidity_percent", "pressure_pa", "pressure_hpa"})


class ControllerSettings(BaseModel, frozen=True, extra="forbid"):
    """The rig controller: serial line, timeouts and limits checked by the host."""

    kind: ControllerKind = "none"
    port: str = ""
    baud: int = Field(default=115200, gt=0)
    timeout_s: float = Field(default=0.2, gt=0, le=5)
    retries: int = Field(default=2, ge=0, le=10)
    heartbeat_s: float = Field(default=0.25, gt=0, le=2)
    watchdog_s: float = Field(default=1.5, ge=0.1, le=5)
    """Time without a heartbeat after which the board puts every output into its safe state."""
    starter_max_s: float = Field(default=5.0, gt=0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the controller's serial port, or see `rig doctor`")
        if self.watchdog_s < 2 * self.heartbeat_s:
            raise ValueError(
                f"watchdog_s {self.watchdog_s:g} is too short for heartbeat_s {self.heartbeat_s:g};"
                " at least two heartbeats must fit in"
            )
        return self


OWN_TIME = "time_s"
"""Name of the column that holds the auxiliary seismometer's own clock."""
_MAX_COMPONENTS = 3


class SeismometerSettings(BaseModel, frozen=True, extra="forbid"):
    """An auxiliary seismometer: a geophone, tiltmeter or seismometer that stands next to the rig.

    Each line that it writes holds a sample: the numbers of the `columns` in their order, between commas,
    semicolons or spaces; text around them is ignored. A column `time_s` is the instrument's own clock.
    """

    kind: Literal["none", "simulated", "serial"] = "none"
    port: str = ""
    baud: int = Field(default=115200, gt=0)
    columns: tuple[str, ...] = Field(
        default=("along", "across"), description="one to three, in any unit; and time_s"
    )
    stale_after_s: float = Field(
        default=10.0, gt=0, description="it counts as silent after this time without a sample"
    )

    @property
    def components(self) -> tuple[str, ...]:
        """The columns without the instrument's clock."""
        return tuple(name for name in self.columns if name != OWN_TIME)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the seismometer's serial port, or see `rig doctor`")
        if len(set(self.columns)) < len(self.columns) or not 1 <= len(self.components) <= _MAX_COMPONENTS:
            raise ValueError(
                f"columns = {list(self.columns)} must be one to {_MAX_COMPONENTS} different names, and "
                f"{OWN_TIME} where the instrument has a clock"
            )
        return self


def _check_pattern(pattern: str) -> str:
    try:
        groups = set(re.compile(pattern).groupindex)
    except re.error as error:
        raise ValueError(f"pattern {pattern!r} is not a regular expression: {error}") from None
    if not groups or groups - _QUANTITIES:
        raise ValueError(
            f"pattern {pattern!r} names {', '.join(sorted(groups)) or 'nothing'}; it must name at least "
            f"one of {', '.join(f'(?P<{name}>...)' for name in sorted(_QUANTITIES))}, and nothing else"
        )
    return pattern


class EnvironmentSettings(BaseModel, frozen=True, extra="forbid"):
    """The sensor of temperature, humidity and pressure."""

    kind: EnvironmentKind = "none"
    port: str = ""
    baud: int = Field(default=9600, gt=0)
    pattern: Annotated[str, AfterValidator(_check_pattern)] = (
        r"(?P<temperature_c>[-+\d.]+)[,;\s]+(?P<humidity_percent>[\d.]+)[,;\s]+(?P<pressure_hpa>[\d.]+)"
    )
    """Expression that is searched in each line; its named groups identify the numbers."""
    request: str = ""
    """Text that is sent once per `period_s` to a sensor that writes only on request."""
    period_s: float = Field(default=1.0, gt=0)
    stale_after_s: float = Field(default=30.0, gt=0)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.kind == "serial" and not self.port:
            raise ValueError("port is missing; name the sensor's serial port, or see `rig doctor`")
        return self
