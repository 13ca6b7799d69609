"""What a camera does by itself to its images, which another program may have left on.

Names are those of the Standard Feature Naming Convention (SFNC) and of older cameras.
"""

from typing import Final

from acquisition.cameras.named_features import NamedFeatures, is_on

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
