"""What a camera does by itself to its images, which another program may have left on.

Names are those of the Standard Feature Naming Convention (SFNC) and of older cameras.
"""

from typing import Final

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
