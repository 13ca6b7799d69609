"""The configured camera: its settings against the requested ones, and when it collects light."""

import math
import re

from acquisition.camera import Camera, CameraInfo, CameraSettings
from acquisition.cameras import drivers
from acquisition.frames.queue import Policy
from calibration import GLOBAL, Shutter
from processing.errors import ConfigurationError
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


_OF_THE_IMAGE = (
    "exposure_us", "gain_db", "frame_rate_hz", "pixel_format",
    "width_px", "height_px", "offset_x_px", "offset_y_px",
)  # fmt: skip


def with_read_back(asked: CameraSettings, applied: CameraSettings) -> CameraSettings:
    """The settings that make the same images again: where nothing was asked for, what the camera has."""
    unasked = [name for name in _OF_THE_IMAGE if getattr(asked, name) is None]
    return asked.model_copy(update={name: getattr(applied, name) for name in unasked})


def setting_differences(asked: CameraSettings, applied: CameraSettings) -> list[str]:
    """One line for each setting in which the camera differs from the request."""
    lines = []
    plain = asked.model_dump(exclude_none=True, exclude={"features"})
    pairs = [(name, wanted, getattr(applied, name)) for name, wanted in plain.items()]
    pairs += [
        (f"features.{name}", wanted, applied.features.get(name, "nothing"))
        for name, wanted in asked.features.items()
    ]
    for name, wanted, got in pairs:
        near = (
            isinstance(wanted, float)
            and isinstance(got, int | float)
            and abs(got - wanted) <= 1e-3 * abs(wanted)
        )
        if got != wanted and not near:
            lines.append(f"camera.{name} = {wanted} was requested, the camera reports {got}")
    if applied.exposure_us is not None and asked.frame_rate_hz is not None:
        possible_hz = 1e6 / applied.exposure_us
        if min(asked.frame_rate_hz, applied.frame_rate_hz or math.inf) > 1.001 * possible_hz:
            lines.append(
                f"camera.frame_rate_hz = {asked.frame_rate_hz:g} was requested, "
                f"an exposure of {applied.exposure_us:g} µs leaves at most {possible_hz:g} Hz"
            )
    return lines


def check_full_scale(config: Configuration, info: CameraInfo, applied: CameraSettings) -> None:
    """Raise ConfigurationError if [sensor] states more than a pixel of this camera can hold."""
    # what a camera says when it is opened may be of the format before
    bits = re.search(r"\d+$", applied.pixel_format or "")
    most_dn = max(info.full_scale_dn, 2 ** int(bits[0]) - 1 if bits else 0)
    if config.sensor is not None and config.sensor.full_scale_dn > most_dn:
        raise ConfigurationError(
            f"sensor.full_scale_dn = {config.sensor.full_scale_dn:g}: the camera ends at {most_dn} DN; "
            "state that, or ask for more bits with camera.pixel_format"
        )


def frame_policy(config: Configuration) -> Policy:
    """Policy for a full queue: sources on demand wait and lose no frame; a real camera cannot wait."""
    return "wait" if config.on_demand else "every"


def shutter_of(config: Configuration) -> Shutter:
    """The shutter as far as it matters: with a pulsed laser all rows see the light at one time."""
    return GLOBAL if config.laser.pulse_us else config.shutter or GLOBAL


def shift_to_light_ns(config: Configuration, info: CameraInfo, applied: CameraSettings) -> int:
    """What is added to the camera's timestamps so that they mark the middle of the light.

    That is the middle of the laser's pulse, otherwise of the first row's exposure. 0 for a camera without a
    clock, or whose exposure is not known and matters.
    """
    stamped = config.camera.stamped or info.stamped
    exposure_us = applied.exposure_us
    if config.laser.pulse_us:
        middle_us = config.laser.pulse_delay_us + 0.5 * config.laser.pulse_us
    else:
        middle_us = 0.5 * (exposure_us or 0.0)
    if not info.has_clock or (exposure_us is None and (stamped != "start" or not config.laser.pulse_us)):
        return 0
    stamped_us = 0.0
    if stamped == "middle":
        stamped_us = 0.5 * (exposure_us or 0.0)
    elif stamped == "end":
        stamped_us = (exposure_us or 0.0) + 1e6 * _readout_s(config, info, applied)
    return round(1e3 * (middle_us - stamped_us))


def pulse_faults(config: Configuration, info: CameraInfo, applied: CameraSettings) -> list[str]:
    """What is wrong with the laser's pulses: they must lie where all rows are exposed together."""
    laser = config.laser
    if not laser.pulse_us:
        return []
    faults = []
    end_us = laser.pulse_delay_us + laser.pulse_us
    if applied.exposure_us is not None and end_us > applied.exposure_us:
        faults.append(
            f"laser.pulse_us: the pulse ends {end_us:g} µs after the exposure begins, "
            f"which takes {applied.exposure_us:g} µs"
        )
    readout_us = 1e6 * _readout_s(config, info, applied)
    if laser.pulse_delay_us < readout_us:
        faults.append(
            f"laser.pulse_delay_us = {laser.pulse_delay_us:g}: "
            f"the last row is exposed from {readout_us:.0f} µs on"
        )
    return faults


def _readout_s(config: Configuration, info: CameraInfo, applied: CameraSettings) -> float:
    """From the first row to the last one."""
    rows = applied.height_px or info.height_px
    return (config.shutter or GLOBAL).row_time_s * (rows - 1)
