"""The wizard of each kind of calibration."""

from processing.errors import ConfigurationError
from rig.settings import Configuration
from rig.wizards.calibration import CalibrationWizard
from rig.wizards.lever import CheckWizard, LeverWizard
from rig.wizards.of_records import AxesWizard, ClockWizard, PointingWizard, ShutterWizard
from rig.wizards.sensor import SensorWizard

KINDS = ("lever", "axes", "sensor", "clock", "shutter", "pointing", "check")


def calibration_wizard(kind: str, config: Configuration | None = None) -> CalibrationWizard:
    """The wizard of one of `KINDS`; `config` is that of the rig, where one is at hand."""
    plain: dict[str, type[CalibrationWizard]] = {
        "lever": LeverWizard,
        "axes": AxesWizard,
        "clock": ClockWizard,
        "shutter": ShutterWizard,
        "pointing": PointingWizard,
    }
    if kind == "sensor":
        return SensorWizard(_full_scale_dn(config))
    if kind == "check":
        return CheckWizard(None if config is None else config.calibration.lever)
    if kind not in plain:
        raise ConfigurationError(f"{kind!r}: no such calibration; there are {', '.join(KINDS)}")
    return plain[kind]()


def _full_scale_dn(config: Configuration | None) -> int | None:
    """Of the pixel format that is asked of the camera; its images may be stored with more bits."""
    stated = None if config is None else config.camera.pixel_format
    return None if stated is None else 2 ** int(stated.removeprefix("mono")) - 1
