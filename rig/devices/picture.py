"""Looks at a camera without a run: figures of a picture, the right exposure, features."""

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
# sqrt(A / B) for exp(-u) - 0.1 where it is positive, u = r^2 / (2 s^2), u0 = ln 10:
# A = (1 - exp(-2 u0) (1 + 2 u0)) / 2, B = 0.99 / 2 - 0.2 * 0.9 + 0.01 u0
_OF_A_CUT_GAUSSIAN = 1.1816


class PictureFigures(NamedTuple):
    """Figures of one picture.

    Attributes
    ----------
    peak
        Brightest value as a fraction of full scale, without single hot pixels (median of 3 x 3).
    saturated_px
        Pixels at full scale.
    background
        Median of the picture as a fraction of full scale.
    sharpness_per_px
        sqrt(sum |grad I|^2 / sum I^2), where I is the light above the background. For a round Gaussian
        spot of standard deviation s it is 1 / s, whatever the exposure. 0 for a picture without light.
    """

    peak: float
    saturated_px: int
    background: float
    sharpness_per_px: float


def figures(image: Image, full_scale_dn: int) -> PictureFigures:
    """Figures of a picture, shape (ny, nx), in DN."""
    calm = cv2.medianBlur(image, 3)
    background_dn = float(np.median(image))
    light = calm.astype(np.float64) - background_dn
    # subtract a tenth of the peak, to exclude the noise of the background
    floor_dn = _FLOOR * max(light.max(initial=0.0), 0.0)
    light = np.maximum(_where_lit(light, floor_dn) - floor_dn, 0.0)
    rows, columns = np.gradient(light)
    energy = float(np.sum(light * light))
    gradient = float(np.sum(rows * rows + columns * columns))
    return PictureFigures(
        float(calm.max()) / full_scale_dn,
        int(np.count_nonzero(image >= full_scale_dn)),
        background_dn / full_scale_dn,
        float(np.sqrt(gradient / energy)) / _OF_A_CUT_GAUSSIAN if energy > 0 else 0.0,
    )


def _where_lit(light: NDArray[np.float64], floor_dn: float) -> NDArray[np.float64]:
    """The part of the picture above the floor, with a margin for its gradient; it is small, and so fast."""
    left, top, width, height = cv2.boundingRect((light > floor_dn).astype(np.uint8))
    margin = 2
    return light[
        max(top - margin, 0) : max(top + height + margin, 2),
        max(left - margin, 0) : max(left + width + margin, 2),
    ]


def average(frames: Sequence[Frame]) -> Image:
    """Mean of frames, in their pixel type; reduces noise and speckle."""
    first = frames[0].image
    total = np.zeros(first.shape, np.float64)
    for frame in frames:
        total += frame.image
    mean = np.rint(total / len(frames))
    return mean.astype(np.uint8) if first.dtype == np.uint8 else mean.astype(np.uint16)


def png_of(image: NDArray[Any], path: Path) -> bytes:
    """An image as PNG, with every bit; DataError, which names the `path`, if it cannot be one."""
    done, png = cv2.imencode(".png", image)
    if not done:
        raise DataError(f"{path}: cannot be written as PNG")
    return png.tobytes()


def read_frames(
    camera: Camera, count: int, patience_s: float, on_frame: Callable[[Frame], object] = lambda _: None
) -> list[Frame]:
    """That many frames of a configured camera, which is started and stopped; DataError if it gives fewer.

    Frames that no camera may deliver raise DeviceError. `on_frame` is called with every frame as it comes.
    """
    frames, delivered = list[Frame](), FrameChecks()
    camera.start()
    try:
        while len(frames) < count and (frame := camera.read(patience_s)) is not None:
            frames.append(delivered.check(frame))
            on_frame(frames[-1])
    finally:
        camera.stop()
    if len(frames) < count:
        raise DataError(f"the camera gave {len(frames)} frames, {count} were asked for")
    return frames


_MEDIAN_FRAMES = 9
"""Number of frames; it is odd, so that a flash or a late change of the exposure does not move the median."""
_MAX_EXPOSURE_STEPS = 16
"""Largest number of steps, by factors of 0.4 to 8: from 10 us to 1 s are 6 steps, back 13."""
_TIMEOUT_S = 5.0
_PEAK_TOLERANCE = 0.03
"""Relative tolerance of the peak; with a target of 0.7 of full scale, saturation is still far."""


class Exposure(NamedTuple):
    """The settings read back from the camera, and the peak as a fraction of full scale."""

    applied: CameraSettings
    exposure_us: float
    peak: float


def find_exposure(
    camera: Camera,
    info: CameraInfo,
    applied: CameraSettings,
    target: float = 0.7,
    on_frame: Callable[[Frame], object] = lambda _: None,
) -> Exposure:
    """Vary the exposure time until the peak is at `target` of full scale, within 3 % of it.

    Parameters
    ----------
    camera
        Open, configured and stopped; it is stopped again afterwards and keeps the exposure time.
    applied
        Settings that the camera has read back.
    on_frame
        Is called with every frame.

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
    for _ in range(_MAX_EXPOSURE_STEPS):
        seen = _look(camera, info, on_frame)
        if not seen.saturated_px and abs(seen.peak - target) <= _PEAK_TOLERANCE * target:
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
    state = "saturated" if seen.saturated_px else f"at {100 * seen.peak:.0f} % of full scale"
    raise DeviceError(
        f"{info.model}: the peak stays {state} with an exposure of {exposure_us:g} µs "
        f"(at most {longest_us:g} µs at this frame rate), not at {100 * target:.0f} %; "
        "change laser power, gain or frame rate, and check that the spot is on the sensor"
    )


def _look(camera: Camera, info: CameraInfo, on_frame: Callable[[Frame], object]) -> PictureFigures:
    frames = read_frames(camera, _MEDIAN_FRAMES, _TIMEOUT_S, on_frame)
    seen = [figures(frame.image, info.full_scale_dn) for frame in frames]
    return PictureFigures(
        statistics.median(one.peak for one in seen),
        max(one.saturated_px for one in seen),
        statistics.median(one.background for one in seen),
        statistics.median(one.sharpness_per_px for one in seen),
    )


_NO_LIMIT = 2.0**62
"""A larger limit means none: cameras report the type's largest number for a feature without a limit."""


def feature_lines(readings: Iterable[FeatureReading]) -> Iterator[str]:
    """One line for each feature: name, value with its unit, range or choices, access."""
    shown = [(reading.name, _value(reading), _remark(reading)) for reading in readings]
    names = max((len(name) for name, _, _ in shown), default=0)
    values = min(max((len(value) for _, value, _ in shown), default=0), 24)
    for name, value, remark in shown:
        yield f"{name:<{names}}  {value:<{values}}  {remark}".rstrip()


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
    if abs(low) >= _NO_LIMIT and abs(high) >= _NO_LIMIT:
        return ""
    return f"{low:.9g} to {high:.9g} {reading.unit}".strip()
