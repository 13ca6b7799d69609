"""Finds the exposure time at which the peak of the spot is a given fraction of full scale."""

import statistics
from typing import NamedTuple

from acquisition.camera import Camera, CameraInfo, CameraSettings
from processing.errors import DeviceError
from rig.devices.picture import PictureFigures, figures

_FRAMES = 9
"""An odd number, whose median a single flash or a late change of the exposure does not move."""
_STEPS = 16
"""A step is at most eight times longer, or 0.4 times as long: from 10 us to 1 s are 6 of them, back 13."""
_TOLERANCE = 0.03
"""Of the target: far from saturation still, with a target of 0.7 of full scale."""


class Exposure(NamedTuple):
    """The settings read back from the camera, and the peak as a fraction of full scale."""

    applied: CameraSettings
    exposure_us: float
    peak: float


def find_exposure(
    camera: Camera, info: CameraInfo, applied: CameraSettings, target: float = 0.7, timeout_s: float = 5.0
) -> Exposure:
    """Vary the exposure time until the peak is at `target` of full scale, within 3 % of it.

    Parameters
    ----------
    camera
        Open, configured and stopped; it is stopped again afterwards and keeps the exposure time.
    applied
        Settings that the camera has read back.

    Raises
    ------
    DeviceError
        The camera has no adjustable exposure time, or the target cannot be reached.
    """
    exposure_us = applied.exposure_us
    if exposure_us is None:
        raise DeviceError(f"{info.model}: the exposure time cannot be set; reduce the laser power instead")
    # a longer exposure would slow the camera down
    longest_us = 0.95e6 / applied.frame_rate_hz if applied.frame_rate_hz else 1e6
    seen: PictureFigures | None = None
    for _ in range(_STEPS):
        seen = _look(camera, info, timeout_s)
        if not seen.saturated_px and abs(seen.peak - target) <= _TOLERANCE * target:
            return Exposure(applied, exposure_us, seen.peak)
        light = seen.peak - seen.background
        if seen.saturated_px:
            factor = 0.4
        elif light <= 0.01:
            factor = 8.0
        else:
            factor = min(max((target - seen.background) / light, 0.1), 8.0)
        wanted_us = min(exposure_us * factor, longest_us)
        applied = camera.configure(CameraSettings(exposure_us=wanted_us))
        if applied.exposure_us is None or applied.exposure_us == exposure_us:
            break
        exposure_us = applied.exposure_us
    assert seen is not None
    state = "saturated" if seen.saturated_px else f"at {seen.peak:.0%} of full scale"
    raise DeviceError(
        f"{info.model}: the peak stays {state} with an exposure of {exposure_us:g} us "
        f"(at most {longest_us:g} us at this frame rate), {target:.0%} was wanted; "
        "change laser power, gain or frame rate, and see that the spot is on the sensor"
    )


def _look(camera: Camera, info: CameraInfo, timeout_s: float) -> PictureFigures:
    camera.start()
    try:
        seen: list[PictureFigures] = []
        while len(seen) < _FRAMES:
            frame = camera.read(timeout_s)
            if frame is None:
                raise DeviceError(f"{info.model}: no more frames; finding an exposure needs a live camera")
            seen.append(figures(frame.image, info.full_scale_dn))
    finally:
        camera.stop()
    return PictureFigures(
        statistics.median(one.peak for one in seen),
        max(one.saturated_px for one in seen),
        statistics.median(one.background for one in seen),
        statistics.median(one.sharpness_per_px for one in seen),
    )
