"""Binning of a GenICam camera: pixels of the sensor that it combines to one of the image.

Names are those of the Standard Feature Naming Convention (SFNC).
"""

from typing import Final

from acquisition.cameras.named_features import NamedFeatures
from processing.errors import DeviceError

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
