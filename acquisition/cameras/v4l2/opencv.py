"""A video device read through OpenCV: on systems without Video4Linux, or if configured."""

import os
import sys
import time
from typing import Any

import cv2
import numpy as np

from acquisition.camera import (
    BITS_OF_FORMAT,
    CameraInfo,
    CameraLost,
    CameraSettings,
    PixelFormat,
    without_features,
)
from acquisition.cameras.device_settings import V4l2Settings
from acquisition.cameras.v4l2.source import RawFrame
from acquisition.frame import Image
from processing.errors import DeviceError

_FOURCC: dict[PixelFormat, str] = {"mono8": "GREY", "mono10": "Y10 ", "mono12": "Y12 ", "mono16": "Y16 "}
_ON_LINUX = sys.platform == "linux"
_MANUAL_EXPOSURE = 1.0 if _ON_LINUX else 0.25
_FAILURES_OF_A_LOST_CAMERA = 3
_QUICK_FAILURE_S = 0.2
_MOST_STALE_FRAMES = 32


class OpenCvSource:
    """See `source.FrameDevice`; its `next` is called by `camera.ReadAhead`, as it cannot be limited in time.

    OpenCV has no sequence numbers. Its timestamp is the driver's with Video4Linux; elsewhere it is not used.
    The reason of a failed read is not known: three successive reads that fail quickly are taken for a lost
    camera.
    """

    def __init__(self, settings: V4l2Settings) -> None:
        self._settings = settings
        self._place: str | int = settings.device or 0
        if isinstance(self._place, str) and self._place.isdigit():
            self._place = int(self._place)
        self._capture: Any = None
        self._pixel_format: PixelFormat = "mono8"
        self._started_ns = 0
        self._failures = 0

    def open(self) -> CameraInfo:
        """Open the device, with the raw format if OpenCV supports it."""
        if self._settings.serial is not None:
            raise DeviceError(
                "OpenCV does not support serial numbers; set camera.v4l2.device instead of serial"
            )
        if _ON_LINUX:
            # OpenCV reads this when a capture is opened; otherwise it waits ten seconds for a frame
            os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
        capture = cv2.VideoCapture(self._place, cv2.CAP_V4L2 if _ON_LINUX else cv2.CAP_ANY)
        if not capture.isOpened():
            raise DeviceError(
                f"{self._name}: OpenCV cannot open it; is it plugged in, and not in use by another program?"
            )
        self._capture = capture
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        self._pixel_format = next((name for name, code in _FOURCC.items() if self._set_fourcc(code)), "mono8")
        return CameraInfo(
            driver="v4l2",
            vendor="",
            model=f"{self._place} through OpenCV ({capture.getBackendName()})",
            serial="",
            width_px=int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            height_px=int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            full_scale_dn=2 ** BITS_OF_FORMAT[self._pixel_format] - 1,
            has_clock=_ON_LINUX,
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set each property and read it back, because OpenCV's `set` does not report failures reliably."""
        capture = self._capture
        if settings.offset_x_px or settings.offset_y_px:
            raise DeviceError(f"{self._name}: OpenCV has no region of interest; leave the offsets out")
        if settings.gain_db is not None:
            raise DeviceError(
                f"{self._name}: its gain has steps of its own, not decibels; set camera.v4l2.gain instead"
            )
        without_features(settings, self._name)
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        capture.set(cv2.CAP_PROP_AUTO_WB, 0)
        if settings.pixel_format not in (None, self._pixel_format):
            self._set_pixel_format(settings.pixel_format)
        for prop, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, settings.width_px),
            (cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px),
            (cv2.CAP_PROP_FPS, settings.frame_rate_hz),
        ):
            if value is not None:
                capture.set(prop, value)
        if settings.exposure_us is not None:
            steps = settings.exposure_us / 100.0 if _ON_LINUX else np.log2(settings.exposure_us * 1e-6)
            if not capture.set(cv2.CAP_PROP_EXPOSURE, round(float(steps))):
                raise DeviceError(f"{self._name}: has no exposure time; leave camera.exposure_us out")
        wanted = self._settings.gain
        if wanted is not None:
            capture.set(cv2.CAP_PROP_GAIN, wanted)
            taken = capture.get(cv2.CAP_PROP_GAIN)
            if taken != wanted:
                raise DeviceError(
                    f"{self._name}: gain = {wanted} was requested, the camera set {taken:g}; "
                    "is its automatic gain on?"
                )
        return self._readings()

    def start(self) -> None:
        """Discard the frames that the driver has buffered: OpenCV streams from `open` on."""
        self._failures = 0
        self._started_ns = time.monotonic_ns()
        for _ in range(_MOST_STALE_FRAMES):
            begin_s = time.monotonic()
            if not self._capture.grab() or time.monotonic() - begin_s > 0.002:
                break

    def next(self) -> RawFrame | None:
        """The next frame, None after a read that failed slowly."""
        begin_s = time.monotonic()
        good, picture = self._capture.read()
        host_time_ns = time.monotonic_ns()
        if not good or picture is None:
            quick = time.monotonic() - begin_s < _QUICK_FAILURE_S
            gone = _ON_LINUX and isinstance(self._place, str) and not os.path.exists(self._place)
            self._failures += quick
            if gone or self._failures >= _FAILURES_OF_A_LOST_CAMERA:
                raise CameraLost(f"{self._name}: delivers no more frames; plug it in again")
            return None
        self._failures = 0
        device_time_ns = -1
        if _ON_LINUX:
            device_time_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            if device_time_ns < self._started_ns:
                return None
        return RawFrame(self._grey(picture), -1, device_time_ns, host_time_ns)

    def stop(self) -> None:
        """Does nothing: OpenCV streams until it is closed, and `start` discards old frames."""

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    @property
    def _name(self) -> str:
        return f"video device {self._place}"

    def _grey(self, picture: Any) -> Image:
        if picture.ndim == 3 and picture.shape[2] == 3:
            picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        elif picture.ndim == 3:
            picture = picture[:, :, 0]  # YUYV: the luminance
        if picture.dtype not in (np.uint8, np.uint16) or min(picture.shape) < 2:
            raise DeviceError(
                f"{self._name}: delivers {picture.dtype} of shape {picture.shape}, which is not an image"
            )
        image: Image = np.array(picture, copy=True)
        image.flags.writeable = False
        return image

    def _set_fourcc(self, fourcc: str) -> bool:
        code = cv2.VideoWriter.fourcc(*fourcc)
        self._capture.set(cv2.CAP_PROP_FOURCC, code)
        return int(self._capture.get(cv2.CAP_PROP_FOURCC)) == code

    def _set_pixel_format(self, wanted: PixelFormat) -> None:
        if not self._set_fourcc(_FOURCC[wanted]):
            there = [name for name, fourcc in _FOURCC.items() if self._set_fourcc(fourcc)]
            self._set_fourcc(_FOURCC[self._pixel_format])
            raise DeviceError(
                f"{self._name}: pixel format {wanted} is not supported; "
                f"there are {', '.join(there) or 'mono8'}"
            )
        self._pixel_format = wanted

    def _readings(self) -> CameraSettings:
        capture = self._capture
        rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
        exposure_us = float(capture.get(cv2.CAP_PROP_EXPOSURE)) * 100.0 if _ON_LINUX else 0.0
        return CameraSettings(
            exposure_us=exposure_us if exposure_us > 0 else None,
            frame_rate_hz=rate_hz if rate_hz > 0 else None,
            pixel_format=self._pixel_format,
            width_px=int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            height_px=int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            offset_x_px=0,
            offset_y_px=0,
        )
