"""When runs of a plan may begin: bands of air and ground, and how long they wait for them."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, Field


def _rising(band: tuple[float, float]) -> tuple[float, float]:
    if band[0] >= band[1]:
        raise ValueError(f"{list(band)}: its first value should be the smaller one")
    return band


Band = Annotated[tuple[float, float], AfterValidator(_rising)]


class RunConditions(BaseModel, frozen=True, extra="forbid"):
    """A run begins only while all of them are met; they are limits of its preflight."""

    temperature_c: Band | None = Field(default=None, description="a run begins only while the air is between")
    humidity_percent: Band | None = Field(
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

    @property
    def asks_the_air(self) -> bool:
        """Whether they need a sensor of the air."""
        return self.temperature_c is not None or self.humidity_percent is not None

    @property
    def asks_the_rest(self) -> bool:
        """Whether they need a look at the resting pendulum."""
        return self.quiet_arcsec is not None or self.ground_rad_per_s2_rthz is not None

    def limits(self) -> list[str]:
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
