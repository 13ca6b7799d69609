"""A GenICam camera's features by name, and what it is wired to by them: a trigger, whatever shows its
exposures, the clock of the network.

Names are those of the Standard Feature Naming Convention (SFNC) and of older cameras.
"""

from abc import ABC, abstractmethod
from typing import Final

from acquisition.camera import CameraSettings, Edge, FeatureValue
from processing.errors import DeviceError

_KEPT: Final = ("trigger", "trigger_edge", "exposure_output", "ptp", "binning", "colour_plane")
_FRAME_TRIGGERS: Final = ("FrameStart", "ExposureStart", "AcquisitionStart")
_EDGES: Final[dict[Edge, str]] = {"rising": "RisingEdge", "falling": "FallingEdge"}
_EXPOSURE: Final = "ExposureActive"
_PTP: Final = ("PtpEnable", "GevIEEE1588")
_PTP_LATCHES: Final = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")


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


def with_kept(settings: CameraSettings, before: CameraSettings) -> CameraSettings:
    """The settings with wiring, binning and colour of those `before` where they leave them out."""
    kept = {name: getattr(before, name) for name in _KEPT if getattr(settings, name) is None}
    return settings.model_copy(update=kept)


def wire(features: NamedFeatures, settings: CameraSettings) -> None:
    """Set trigger, exposure output and network clock; without a trigger the camera runs freely."""
    if settings.trigger is None:
        run_freely(features)
    else:
        _wait_for(features, settings.trigger, settings.trigger_edge or "rising")
    if settings.exposure_output is not None:
        _show_exposure(features, settings.exposure_output)
    if settings.ptp is not None:
        switch = _first(features, _PTP)
        if switch:
            features.write(switch, settings.ptp)
        elif settings.ptp:
            raise DeviceError(f"{features.name}: has no {_PTP[0]}; leave camera.ptp out")


def wired(features: NamedFeatures, settings: CameraSettings) -> dict[str, str | bool]:
    """What the camera says of its wiring, by the settings' names, as far as `settings` ask for it."""
    found: dict[str, str | bool] = {}
    if settings.trigger is not None and features.read("TriggerMode") == "On":
        found["trigger"] = str(features.read("TriggerSource"))
        for edge, name in _EDGES.items():
            if features.read("TriggerActivation") == name:
                found["trigger_edge"] = edge
    if settings.exposure_output is not None and features.read("LineSource") == _EXPOSURE:
        found["exposure_output"] = str(features.read("LineSelector"))
    if settings.ptp is not None:
        found["ptp"] = any(is_on(features.read(name)) for name in _PTP)
    return found


def run_freely(features: NamedFeatures) -> None:
    """Switch all triggers off."""
    selectors = features.choices("TriggerSelector") if features.writable("TriggerSelector") else ()
    before = features.read("TriggerSelector") if selectors else None
    for selector in selectors or ("",):
        if selector:
            features.write("TriggerSelector", selector)
        if features.writable("TriggerMode") and features.read("TriggerMode") != "Off":
            features.write("TriggerMode", "Off")
    if before is not None:
        features.write("TriggerSelector", before)


def latch_clock_state(features: NamedFeatures) -> None:
    """Have the camera renew its `CLOCK_STATES`, which some do on command only."""
    latch = _first(features, _PTP_LATCHES)
    if latch:
        features.write(latch, True)


def _wait_for(features: NamedFeatures, source: str, edge: Edge) -> None:
    """Start each exposure with an edge on a line, or whatever else the camera can be triggered by."""
    run_freely(features)
    offered = features.choices("TriggerSelector")
    selector = next((name for name in _FRAME_TRIGGERS if name in offered), None)
    if selector is not None and features.writable("TriggerSelector"):
        features.write("TriggerSelector", selector)
    choose(features, "TriggerSource", source, "trigger")
    if _EDGES[edge] in features.choices("TriggerActivation") and features.writable("TriggerActivation"):
        features.write("TriggerActivation", _EDGES[edge])
    choose(features, "TriggerMode", "On", "trigger")


def _show_exposure(features: NamedFeatures, line: str) -> None:
    choose(features, "LineSelector", line, "exposure_output")
    if "Output" in features.choices("LineMode") and features.writable("LineMode"):
        features.write("LineMode", "Output")
    choose(features, "LineSource", _EXPOSURE, "exposure_output")


def _first(features: NamedFeatures, names: tuple[str, ...]) -> str:
    return next((name for name in names if features.writable(name)), "")
