"""Frames of a camera without a run: figures of a picture, the right exposure, features."""

import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Camera, CameraInfo, CameraSettings, Frame, Image
from acquisition.cameras.usb3vision.node_map import READ_WRITE, WRITE_ONLY, FeatureReading
from acquisition.frames.guard import FrameChecks
from processing.errors import DataError, DeviceError

_FLOOR = 0.1
"""Part of the peak that is subtracted, to exclude the noise of the background."""
# sqrt(A / B) for exp(-u) - 0.1 where it is positive, u = r^2 / (2 s^2), u0 = ln 10:
# A = (1 - exp(-2 u0) (1 + 2 u0)) / 2, B = 0.99 / 2 - 0.2 * 0.9 + 0.01 u0
_FLOOR_FACTOR = 1.1816
"""Factor by which the subtracted floor raises the sharpness of a Gaussian."""
_MARGIN_PX = 2


class PictureFigures(NamedTuple):
    """Figures of one picture."""

    peak: float
    """Brightest value as a fraction of full scale, without single hot pixels (median of 3 x 3)."""
    saturated_px: int
    """Number of pixels at full scale."""
    background: float
    """Median of the picture as a fraction of full scale."""
    sharpness_per_px: float
    """sqrt(sum |grad I|^2 / sum I^2), where I is the light above the background; 0 without light. For a round
    Gaussian spot of standard deviation s it is 1 / s, whatever the exposure."""


def figures(image: Image, full_scale_dn: int) -> PictureFigures:
    """Figures of a picture, shape (ny, nx), in DN."""
    smooth = cv2.medianBlur(image, 3)
    background_dn = _median_dn(image)
    light = smooth.astype(np.float64) - background_dn
    floor_dn = _FLOOR * max(light.max(initial=0.0), 0.0)
    light = np.maximum(_lit_part(light, floor_dn) - floor_dn, 0.0)
    gradient_y, gradient_x = np.gradient(light)
    energy = float(np.sum(light * light))
    gradient = float(np.sum(gradient_y * gradient_y + gradient_x * gradient_x))
    return PictureFigures(
        float(smooth.max()) / full_scale_dn,
        int(np.count_nonzero(image >= full_scale_dn)),
        background_dn / full_scale_dn,
        float(np.sqrt(gradient / energy)) / _FLOOR_FACTOR if energy > 0 else 0.0,
    )


def _median_dn(image: Image) -> float:
    """Median of a picture by its histogram; numpy's takes twenty times as long for a whole sensor."""
    values = np.iinfo(image.dtype).max + 1
    below = np.cumsum(cv2.calcHist([image], [0], None, [values], [0, values]), dtype=np.float64)
    return float(np.searchsorted(below, [(image.size - 1) // 2, image.size // 2], side="right").mean())


def _lit_part(light: NDArray[np.float64], floor_dn: float) -> NDArray[np.float64]:
    """The part of the picture above the floor, with a margin for its gradient; the whole would be slow."""
    left, top, width, height = cv2.boundingRect((light > floor_dn).astype(np.uint8))
    return light[
        max(top - _MARGIN_PX, 0) : max(top + height + _MARGIN_PX, 2),
        max(left - _MARGIN_PX, 0) : max(left + width + _MARGIN_PX, 2),
    ]


def average(frames: Sequence[Frame]) -> Image:
    """Mean of frames, in their pixel type; reduces noise and speckle."""
    mean: NDArray[np.float64] = np.rint(np.mean([frame.image for frame in frames], axis=0))
    return mean.astype(np.uint8) if frames[0].image.dtype == np.uint8 else mean.astype(np.uint16)


def png_of(image: NDArray[Any], path: Path) -> bytes:
    """An image as PNG, with every bit; DataError, which names the `path`, if it cannot be one."""
    is_encoded, png = cv2.imencode(".png", image)
    if not is_encoded:
        raise DataError(f"{path}: cannot be written as PNG")
    return png.tobytes()


def read_frames(
    camera: Camera, count: int, timeout_s: float, on_frame: Callable[[Frame], object] = lambda _: None
) -> list[Frame]:
    """`count` frames of a configured camera, which is started and stopped; DataError if it gives fewer.

    A frame that no camera may deliver raises DeviceError. `on_frame` is called with every frame as it comes.
    """
    frames, checks = list[Frame](), FrameChecks()
    camera.start()
    try:
        while len(frames) < count and (frame := camera.read(timeout_s)) is not None:
            frames.append(checks.check(frame))
            on_frame(frames[-1])
    finally:
        camera.stop()
    if len(frames) < count:
        raise DataError(f"the camera gave {len(frames)} frames, {count} were asked for")
    return frames


_MEDIAN_FRAMES = 9
"""Number of frames of a median; it is odd, so that a flash or a late change of the exposure has no effect."""
_MAX_EXPOSURE_STEPS = 16
"""Largest number of steps, by factors of 0.4 to 8: from 10 us to 1 s are 6 steps, back 13."""
_FRAME_TIMEOUT_S = 5.0
_PEAK_TOLERANCE = 0.03
"""Relative tolerance of the peak; with a target of 0.7 of full scale, saturation is still far."""


class Exposure(NamedTuple):
    """The result of a search for the exposure time."""

    applied: CameraSettings
    """Settings read back from the camera."""
    exposure_us: float
    peak: float
    """Peak as a fraction of full scale."""


def find_exposure(
    camera: Camera,
    info: CameraInfo,
    applied: CameraSettings,
    target: float = 0.7,
    on_frame: Callable[[Frame], object] = lambda _: None,
) -> Exposure:
    """Vary the exposure time until the peak is at `target` of full scale, within 3 % of it.

    Raises DeviceError if the camera has no adjustable exposure time, or the target cannot be reached.

    Parameters
    ----------
    camera
        Open, configured and stopped; it is stopped again afterwards and keeps the exposure time.
    applied
        Settings that the camera has read back.
    on_frame
        Is called with every frame.
    """
    exposure_us = applied.exposure_us
    if exposure_us is None:
        raise DeviceError(f"{info.model}: the exposure time cannot be set; reduce the laser power instead")
    # a longer exposure would slow the camera down
    max_us = 0.95e6 / applied.frame_rate_hz if applied.frame_rate_hz else 1e6
    picture: PictureFigures | None = None
    for _ in range(_MAX_EXPOSURE_STEPS):
        picture = _measure(camera, info, on_frame)
        if not picture.saturated_px and abs(picture.peak - target) <= _PEAK_TOLERANCE * target:
            return Exposure(applied, exposure_us, picture.peak)
        light = picture.peak - picture.background
        if picture.saturated_px:
            factor = 0.4
        elif light <= 0.01:
            factor = 8.0
        else:
            factor = min(max((target - picture.background) / light, 0.1), 8.0)
        next_us = min(exposure_us * factor, max_us)
        applied = camera.configure(CameraSettings(exposure_us=next_us))
        if applied.exposure_us is None or applied.exposure_us == exposure_us:
            break
        exposure_us = applied.exposure_us
    assert picture is not None
    state = "saturated" if picture.saturated_px else f"at {100 * picture.peak:.0f} % of full scale"
    raise DeviceError(
        f"{info.model}: the peak stays {state} with an exposure of {exposure_us:g} µs "
        f"(at most {max_us:g} µs at this frame rate), not at {100 * target:.0f} %; "
        "change laser power, gain or frame rate, and check that the spot is on the sensor"
    )


def _measure(camera: Camera, info: CameraInfo, on_frame: Callable[[Frame], object]) -> PictureFigures:
    frames = read_frames(camera, _MEDIAN_FRAMES, _FRAME_TIMEOUT_S, on_frame)
    pictures = [figures(frame.image, info.full_scale_dn) for frame in frames]
    medians = PictureFigures(*map(statistics.median, zip(*pictures, strict=True)))
    return medians._replace(saturated_px=max(picture.saturated_px for picture in pictures))


_MAX_LIMIT = 2.0**62
"""Largest limit of a feature: cameras report the type's largest number for a feature without a limit."""


def feature_lines(readings: Iterable[FeatureReading]) -> Iterator[str]:
    """One line for each feature: name, value with its unit, range or choices, access."""
    rows = [(reading.name, _value(reading), _remark(reading)) for reading in readings]
    name_width = max((len(name) for name, _, _ in rows), default=0)
    value_width = min(max((len(value) for _, value, _ in rows), default=0), 24)
    for name, value, remark in rows:
        yield f"{name:<{name_width}}  {value:<{value_width}}  {remark}".rstrip()


def _value(reading: FeatureReading) -> str:
    value = reading.value
    if reading.kind == "Command":
        return "command"
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return value.hex(" ") or "empty"
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return f"{text} {reading.unit}".strip()


def _remark(reading: FeatureReading) -> str:
    if reading.problem:
        return reading.problem
    if reading.kind == "Command":
        return "" if reading.access == WRITE_ONLY else reading.access
    if reading.access != READ_WRITE:
        return reading.access
    if reading.choices:
        return "one of " + ", ".join(reading.choices)
    low, high = reading.minimum, reading.maximum
    if isinstance(reading.value, bool | str | bytes) or low is None or high is None:
        return ""
    if abs(low) >= _MAX_LIMIT and abs(high) >= _MAX_LIMIT:
        return ""
    return f"{low:.9g} to {high:.9g} {reading.unit}".strip()
