"""What the drivers of GenICam cameras do alike before their settings are applied and after they were read."""

from typing import Final

from acquisition.camera import CameraSettings
from acquisition.cameras import wiring
from acquisition.cameras.colour_plane import in_plane_px
from acquisition.cameras.named_features import NamedFeatures, is_on
from processing.errors import DeviceError


def prepare(features: NamedFeatures, settings: CameraSettings, before: CameraSettings) -> CameraSettings:
    """Leave images alone, bin and wire the camera, which everything else depends on.

    Returns the settings with what stays of those `before` where they leave it out.
    """
    leave_images_alone(features)
    settings = wiring.with_kept(settings, before)
    set_binning(features, settings.binning or 1)
    wiring.wire(features, settings)
    return settings


def waits(settings: CameraSettings) -> bool:
    """Whether the camera shall wait for a trigger, by the rig's setting of it or by its own features."""
    return settings.trigger is not None or any("Trigger" in name for name in settings.features)


def as_prepared(
    features: NamedFeatures, applied: CameraSettings, settings: CameraSettings, possible_hz: float | None
) -> CameraSettings:
    """Settings as read back, with what the camera says of its wiring, in pixels of the colour plane.

    `settings` are those that `prepare` returned, `possible_hz` the rate that exposure and bus leave.
    """
    update: dict[str, object] = dict(wiring.wired(features, settings))
    if settings.trigger is not None:
        update["frame_rate_hz"] = wiring.triggered_rate(settings, possible_hz)
    return in_plane_px(applied.model_copy(update=update), settings.colour_plane)


# What a camera does by itself to its images, which another program may have left on.
#
# Names are those of the Standard Feature Naming Convention (SFNC) and of older cameras.

AUTOMATIC: Final = (
    "ExposureAuto",
    "GainAuto",
    "BalanceWhiteAuto",
    "BlackLevelAuto",
    "GammaAuto",
    "AutoExposureControl",
)
"""Enumerations that are set to "Off", in this order."""
BENDING: Final = ("GammaEnable", "GammaEnabled", "LUTEnable", "SharpnessEnable", "SharpeningEnable")
"""Switches that make DN no longer proportional to light; set to false."""
RESULTING_RATES: Final = (
    "AcquisitionResultingFrameRate",
    "ResultingFrameRate",
    "ResultingFrameRateAbs",
    "AcquisitionResultingFrameRateAbs",
)
"""Frames per second that exposure, size and bus leave, by what different makers call it."""


def leave_images_alone(features: NamedFeatures) -> None:
    """Switch off what the camera does by itself to its images; the exposure is as long as it is set."""
    for name in AUTOMATIC:
        if "Off" in features.choices(name) and features.writable(name):
            features.write(name, "Off")
    for name in BENDING:
        if features.writable(name) and is_on(features.read(name)):
            features.write(name, False)
    if "Timed" in features.choices("ExposureMode") and features.writable("ExposureMode"):
        features.write("ExposureMode", "Timed")


# Binning of a GenICam camera: pixels of the sensor that it combines to one of the image.
#
# Names are those of the Standard Feature Naming Convention (SFNC).

_BINNING: Final = ("BinningHorizontal", "BinningVertical")
_DECIMATION: Final = ("DecimationHorizontal", "DecimationVertical")


def set_binning(features: NamedFeatures, binning: int) -> None:
    """Combine this many pixels in each direction and leave none out; 1 undoes what another program set."""
    wanted = dict.fromkeys(_BINNING, binning) | dict.fromkeys(_DECIMATION, 1)
    for name, value in wanted.items():
        now = features.read(name)
        if now is None and value == 1:
            continue
        if now is None:
            raise DeviceError(f"{features.name}: has no {name}; leave camera.binning out")
        if float(now) != value:
            if features.writable(name):
                features.write(name, value)
            got = features.read(name)
            if got is None or float(got) != value:
                raise DeviceError(
                    f"{features.name}: {name} = {value} was requested, the camera reports {got}; "
                    "set camera.binning to what it can do"
                )


def binning_of(features: NamedFeatures) -> int | None:
    """Pixels of the sensor in each direction that make one of the image; None if the camera does not say."""
    now = features.read(_BINNING[0])
    return None if now is None else round(float(now))
