"""Section [camera]: the choice of the camera, its settings, and a subsection for each registered driver."""

from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field, create_model, field_validator

from acquisition.camera import CameraSettings, Stamped
from acquisition.cameras.drivers import (
    DRIVERS,
    default_settings,
    settings_models,
    unknown_driver,
)
from processing.errors import ConfigurationError


class CameraChoice(CameraSettings, frozen=True, extra="forbid"):
    """The choice of the camera, and the settings requested from it."""

    driver: str = Field(description=f"one of {', '.join(DRIVERS)}; simulated invents its numbers")
    serial: str | None = Field(default=None, description="needed only if several cameras are plugged in")
    timeout_s: float = Field(
        default=5.0,
        gt=0,
        description="the camera counts as stalled after this time without a frame, or two frame times",
    )

    stamped: Stamped | None = Field(
        default=None,
        description="moment of the exposure that the timestamps mark; None: as the driver knows it",
    )

    @field_validator("driver")
    @classmethod
    def _registered(cls, driver: str) -> str:
        if driver not in DRIVERS:
            raise ValueError(unknown_driver())
        return driver

    @property
    def patience_s(self) -> float:
        """Time without a frame after which the camera counts as stalled; a slow one gets two frame times."""
        return max(self.timeout_s, 0.5 + 2 / self.frame_rate_hz if self.frame_rate_hz else 0.0)

    def driver_settings(self) -> BaseModel:
        """Section ``[camera.NAME]`` of the chosen driver; its serial number defaults to ``camera.serial``.

        Raises
        ------
        ConfigurationError
            The section is missing and has no defaults, or the driver has no serial numbers.
        """
        stated: BaseModel | None = getattr(self, self.driver)
        if stated is None:
            (model,) = settings_models(self.driver)
            key = next(name for name, field in model.model_fields.items() if field.is_required())
            raise ConfigurationError(
                f"camera.driver = {self.driver!r} needs [camera.{self.driver}] with a {key}: "
                f"--set camera.{self.driver}.{key}=VALUE"
            )
        if self.serial is None or getattr(stated, "serial", None) is not None:
            return stated
        if "serial" not in type(stated).model_fields:
            raise ConfigurationError(
                f"camera.serial = {self.serial!r}: {self.driver!r} has no serial numbers; leave it out"
            )
        return stated.model_copy(update={"serial": self.serial})


# The sections are made from the registry, so a type checker cannot see them; code uses `driver_settings`.
if TYPE_CHECKING:
    CameraSection = CameraChoice
else:

    def _sections() -> dict[str, Any]:
        sections = {}
        for name, driver in DRIVERS.items():
            if not driver.sections:
                (model,) = settings_models(name)
                default = default_settings(model)
                sections[name] = (model | None, None) if default is None else (model, default)
        return sections

    CameraSection = create_model(
        "CameraSection",
        __base__=CameraChoice,
        __module__=__name__,
        __doc__=CameraChoice.__doc__,
        **_sections(),
    )
