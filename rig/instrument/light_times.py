"""When the light of a frame was collected: the whole exposure, or a pulse of the laser within it."""

from acquisition.camera import CameraInfo, CameraSettings
from calibration import GLOBAL, Shutter
from rig.settings import Configuration


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
            f"laser.pulse_us: the pulse ends {end_us:g} us after the exposure begins, "
            f"which takes {applied.exposure_us:g} us"
        )
    readout_us = 1e6 * _readout_s(config, info, applied)
    if laser.pulse_delay_us < readout_us:
        faults.append(
            f"laser.pulse_delay_us = {laser.pulse_delay_us:g}: "
            f"the last row is exposed from {readout_us:.0f} us on"
        )
    return faults


def _readout_s(config: Configuration, info: CameraInfo, applied: CameraSettings) -> float:
    """From the first row to the last one."""
    rows = applied.height_px or info.height_px
    return (config.shutter or GLOBAL).row_time_s * (rows - 1)
