"""What the drivers of GenICam cameras do alike before their settings are applied and after they were read."""

from acquisition.camera import CameraSettings
from acquisition.cameras import wiring
from acquisition.cameras.automatic import leave_images_alone
from acquisition.cameras.binning import set_binning
from acquisition.cameras.colour_plane import in_plane_px
from acquisition.cameras.named_features import NamedFeatures


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
