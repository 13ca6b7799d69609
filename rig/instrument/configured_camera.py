"""Makes the configured camera and compares its settings with the requested ones."""

from acquisition.camera import Camera, CameraSettings
from acquisition.cameras import drivers
from acquisition.frame_queue import Policy
from rig.settings import Configuration


def make_camera(config: Configuration) -> Camera:
    """Make the configured camera without opening it."""
    name = config.camera.driver
    sections = drivers.find_driver(name).sections
    if sections:
        return drivers.make_camera(name, *(getattr(config, section) for section in sections))
    return drivers.make_camera(name, config.camera.driver_settings())


def camera_settings(config: Configuration) -> CameraSettings:
    """The settings requested from the camera."""
    return CameraSettings(**{name: getattr(config.camera, name) for name in CameraSettings.model_fields})


def setting_differences(asked: CameraSettings, applied: CameraSettings) -> list[str]:
    """One line for each setting in which the camera differs from the request."""
    lines = []
    for name, wanted in asked.model_dump(exclude_none=True).items():
        got = getattr(applied, name)
        near = (
            isinstance(wanted, float)
            and isinstance(got, int | float)
            and abs(got - wanted) <= 1e-3 * abs(wanted)
        )
        if got != wanted and not near:
            lines.append(f"camera.{name} = {wanted} was requested, the camera reports {got}")
    return lines


def frame_policy(config: Configuration) -> Policy:
    """Policy for a full queue: sources on demand wait and lose no frame; a real camera cannot wait."""
    return "wait" if config.on_demand else "every"
