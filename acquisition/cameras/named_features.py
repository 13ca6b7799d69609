"""A GenICam camera's features by name, whichever library reads them."""

from abc import ABC, abstractmethod

from acquisition.camera import FeatureValue
from processing.errors import DeviceError


class NamedFeatures(ABC):
    """What code that serves several drivers needs of a camera's features; `name` is the camera's in messages.

    Methods raise DeviceError or the error of the driver's library.
    """

    name: str

    @abstractmethod
    def writable(self, feature: str) -> bool:
        """Whether the camera has the feature and it can be set now."""

    @abstractmethod
    def choices(self, feature: str) -> tuple[str, ...]:
        """Values that an enumeration takes now; none for other features."""

    @abstractmethod
    def read(self, feature: str) -> FeatureValue | None:
        """Value of a feature, possibly as text; None if the camera has none of this name or it is not
        readable now.
        """

    @abstractmethod
    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature; of a command, any value runs it."""


def is_on(value: FeatureValue | None) -> bool:
    """Whether a switch is on, whichever way its library says so."""
    return str(value).lower() in ("true", "1", "on")


def choose(features: NamedFeatures, feature: str, wanted: str, key: str) -> None:
    """Set an enumeration for ``camera.KEY``; DeviceError with what the camera offers, if not this value."""
    if not features.writable(feature):
        raise DeviceError(f"{features.name}: has no {feature} that can be set; leave camera.{key} out")
    offered = features.choices(feature)
    if wanted not in offered:
        raise DeviceError(
            f"{features.name}: camera.{key}: its {feature} cannot be {wanted}; it can be {', '.join(offered)}"
        )
    features.write(feature, wanted)
