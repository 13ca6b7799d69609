"""The camera as configured: which one, what is asked of it, and what it did not take."""

from acquisition.camera import Camera, CameraSettings
from acquisition.cameras import drivers
from acquisition.frame_queue import Policy
from rig.settings import Configuration


def make_camera(config: Configuration) -> Camera:
    """The configured camera, not opened yet."""
    name = config.camera.driver
    sections = drivers.find_driver(name).sections
    if sections:
        return drivers.make_camera(name, *(getattr(config, section) for section in sections))
    return drivers.make_camera(name, config.camera.driver_settings())


def camera_settings(config: Configuration) -> CameraSettings:
    """What is asked of the camera, without the choice of the camera."""
    return CameraSettings(**{name: getattr(config.camera, name) for name in CameraSettings.model_fields})


def setting_differences(asked: CameraSettings, applied: CameraSettings) -> list[str]:
    """One line for each setting that the camera did not take as it was asked."""
    lines = []
    for name, wanted in asked.model_dump(exclude_none=True).items():
        got = getattr(applied, name)
        near = (
            isinstance(wanted, float)
            and isinstance(got, int | float)
            and abs(got - wanted) <= 1e-3 * abs(wanted)
        )
        if got != wanted and not near:
            lines.append(f"camera.{name} = {wanted} was asked, the camera says {got}")
    return lines


def frame_policy(config: Configuration) -> Policy:
    """Sources that can wait are held back and lose nothing; a real camera cannot wait."""
    return "wait" if config.on_demand else "every"
