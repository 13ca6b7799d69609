"""Recorded frames as a `Camera`: in order, on demand, without losses."""

import logging
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import (
    FORMAT_OF_BITS,
    CameraInfo,
    CameraLost,
    CameraSettings,
    CameraStatus,
    Frame,
    Image,
    refuse_features,
)
from acquisition.cameras.files.frame_source import (
    FilesSettings,
    FrameSource,
    FrameTimes,
    StoredImage,
    UnreadableFrame,
    frame_times,
)
from acquisition.cameras.files.sources import open_source
from processing.errors import DeviceError

_log = logging.getLogger(__name__)


class FilesCamera:
    """A `Camera` that plays recorded frames from the first to the last.

    Each `start` begins at the first frame, or, after the disk or share was lost, at the next one, with its
    own number. A frame that cannot be read, or has another size than the first, is skipped, counted in
    ``status.incomplete``, logged, and leaves a gap in the sequence. The timestamps serve as the camera's
    clock. Exposure and gain are unknown (`configure` returns None), the bit depth is fixed. A region of
    interest is cut out.
    """

    def __init__(self, settings: FilesSettings) -> None:
        self._settings = settings
        self._source: FrameSource | None = None
        self._times = FrameTimes([], [])
        self._info: CameraInfo | None = None
        self._region = CameraSettings()
        self._stopped: threading.Event | None = None
        self._lock = threading.Lock()
        self._next = 0
        self._was_lost = False
        self._delivered = 0
        self._incomplete = 0
        self._dropped_by_recorder = 0
        self._reconnects = 0
        self._dtype: np.dtype[Any] | None = None
        self._shape: tuple[int, ...] = ()
        self._skipped: list[tuple[int, str]] = []
        self._first_label = ""
        self.remarks: Sequence[str] = ()
        self.lossy = ""
        self.pixel_aspect = 1.0

    def open(self) -> CameraInfo:
        """Find the frames and their times; reads the first frame that can be read."""
        if self._info is not None:
            return self._info
        path = self._settings.path
        source = open_source(path)
        if source.lossy:
            _log.warning(
                "%s: the codec %s is usually lossy, which makes positions less accurate", path, source.lossy
            )
        for line in source.warnings:
            _log.warning("%s: %s", path, line)
        self.lossy, self.pixel_aspect = source.lossy, source.pixel_aspect
        self.remarks = [*filter(None, [source.summary]), *source.warnings]
        self._times = frame_times(self._settings, source)
        image, full_scale_dn, self._first_label = self._first_image(source)
        self._dtype, self._shape = image.dtype, image.shape
        self._source = source
        self._info = CameraInfo(
            driver="files",
            vendor="",
            model=path.name,
            serial=str(path),
            width_px=image.shape[1],
            height_px=image.shape[0],
            full_scale_dn=full_scale_dn,
            has_clock=True,
            stamped="middle",
        )
        return self._info

    @property
    def count(self) -> int:
        """Number of frames in the source."""
        return 0 if self._source is None else self._source.count

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the region of interest; return the settings that apply."""
        info = self._must_be_open()
        if self._stopped is not None and not self._stopped.is_set():
            raise DeviceError(f"{info.serial}: cannot be configured while frames are running; stop it first")
        refuse_features(settings, info.serial)
        x0, y0 = settings.offset_x_px or 0, settings.offset_y_px or 0
        width = settings.width_px or info.width_px - x0
        height = settings.height_px or info.height_px - y0
        if not 0 < width <= info.width_px - x0 or not 0 < height <= info.height_px - y0:
            raise DeviceError(
                f"{info.serial}: a region of {width}x{height} px at ({x0}, {y0}) does not lie in images of "
                f"{info.width_px}x{info.height_px} px"
            )
        whole = (x0, y0, width, height) == (0, 0, info.width_px, info.height_px)
        region = CameraSettings(width_px=width, height_px=height, offset_x_px=x0, offset_y_px=y0)
        self._region = CameraSettings() if whole else region
        return region.model_copy(
            update={
                "frame_rate_hz": self._settings.frame_rate_hz,
                "pixel_format": FORMAT_OF_BITS.get(info.full_scale_dn.bit_length()),
            }
        )

    def start(self) -> None:
        info = self._must_be_open()
        if self._stopped is not None and not self._stopped.is_set():
            raise DeviceError(f"{info.serial}: is running already; stop it first")
        if self._was_lost:
            self._reconnects += 1
        else:
            self._next = self._delivered = self._incomplete = self._dropped_by_recorder = self._reconnects = 0
        self._was_lost = False
        self._stopped = threading.Event()

    def read(self, timeout_s: float) -> Frame | None:
        """Next frame that can be read; None after the last. `timeout_s` has no effect."""
        stopped = self._stopped
        if stopped is None:
            info = self._must_be_open()
            raise DeviceError(f"{info.serial}: is not started; call start before read")
        while not stopped.is_set():
            with self._lock:
                source = self._source
                if source is None or stopped.is_set():
                    return None
                index = self._next
                if index >= source.count:
                    self._log_skipped(source)
                    if self._delivered == 0:
                        raise DeviceError(
                            f"{self._settings.path}: none of the {self._incomplete} frames can be read"
                        )
                    return None
                self._next += 1
                number = self._times.sequence[index]
                self._dropped_by_recorder += number - (self._times.sequence[index - 1] if index else -1) - 1
                try:
                    image = self._image(source, index)
                except UnreadableFrame as error:
                    self._incomplete += 1
                    self._skipped.append((index, str(error)))
                    continue
                except OSError as error:
                    self._next, self._was_lost = index, True
                    raise CameraLost(
                        f"{self._settings.path}: is no longer available: {error.strerror}"
                    ) from None
                self._log_skipped(source)
            self._delivered += 1
            return Frame(image, number, self._times.time_ns[index], time.monotonic_ns())
        return None

    def stop(self) -> None:
        if self._stopped is not None:
            self._stopped.set()

    def close(self) -> None:
        self.stop()
        with self._lock:
            if self._source is not None:
                self._source.close()
            self._source = None
            self._info = None

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`; `dropped_by_camera` are gaps in the numbers of the timestamps file."""
        return CameraStatus(
            delivered=self._delivered,
            dropped_by_camera=self._dropped_by_recorder,
            incomplete=self._incomplete,
            reconnects=self._reconnects,
        )

    def _log_skipped(self, source: FrameSource) -> None:
        """Log one line on consecutive frames that were skipped."""
        if self._skipped:
            (first, reason), (last, _) = self._skipped[0], self._skipped[-1]
            more = f" and {len(self._skipped) - 1} more, to {source.label(last)}" if last > first else ""
            _log.warning("%s%s: skipped: %s", source.label(first), more, reason)
            self._skipped.clear()

    def _must_be_open(self) -> CameraInfo:
        if self._info is None:
            raise DeviceError(f"{self._settings.path}: is not open; call open first")
        return self._info

    def _first_image(self, source: FrameSource) -> tuple[Image, int, str]:
        reasons = []
        for index in range(source.count):
            try:
                stored = source.read(index)
                return *self._grey(stored, source.label(index)), source.label(index)
            except UnreadableFrame as error:
                reasons.append(str(error))
            except OSError as error:
                raise DeviceError(f"{self._settings.path}: cannot be read: {error.strerror}") from None
        raise DeviceError(
            f"{self._settings.path}: none of the {source.count} frames can be read; the first: {reasons[0]}"
        )

    def _image(self, source: FrameSource, index: int) -> Image:
        image, _ = self._grey(source.read(index), source.label(index))
        if image.dtype != self._dtype:
            raise DeviceError(
                f"{source.label(index)}: its pixels are {image.dtype}, those of {self._first_label} are "
                f"{self._dtype}; convert them to one depth"
            )
        if image.shape != self._shape:
            raise UnreadableFrame(
                f"is {image.shape[1]}x{image.shape[0]} px, {self._first_label} is "
                f"{self._shape[1]}x{self._shape[0]} px"
            )
        region = self._region
        if region.width_px is not None and region.height_px is not None:
            x0, y0 = region.offset_x_px or 0, region.offset_y_px or 0
            image = image[y0 : y0 + region.height_px, x0 : x0 + region.width_px].copy()
        return image

    def _grey(self, stored: StoredImage, label: str) -> tuple[Image, int]:
        """One channel of a frame at the requested bit depth, and its full scale."""
        pixels, full_scale, coloured = stored
        if coloured and self._settings.colour != "brightness":
            raise DeviceError(
                f"{label}: is in colour, with the luminance apart; to use the luminance as it is stored, "
                "state "
                "camera.files.colour = 'brightness'"
            )
        if pixels.ndim == 3:
            pixels = self._one_channel(pixels, label)
        if self._settings.bit_depth is not None:
            full_scale = min(full_scale, 2**self._settings.bit_depth - 1)
        return np.ascontiguousarray(pixels), full_scale

    def _one_channel(self, pixels: NDArray[Any], label: str) -> NDArray[Any]:
        if pixels.shape[2] == 1:
            return pixels[:, :, 0]
        if pixels.shape[2] < 3:
            raise UnreadableFrame(f"{pixels.shape[2]} channels")
        blue, green, red = (pixels[:, :, channel] for channel in range(3))
        if np.array_equal(blue, green) and np.array_equal(green, red):
            return green
        match self._settings.colour:
            case "mean" | "brightness":
                total = blue.astype(np.uint32) + green + red
                mean: NDArray[Any] = ((total + 1) // 3).astype(pixels.dtype)
                return mean
            case "red" | "green" | "blue" as colour:
                return {"red": red, "green": green, "blue": blue}[colour]
        raise DeviceError(
            f"{label}: is a colour image; to use it, state camera.files.colour = "
            "'mean', 'brightness', 'red', 'green' or 'blue'"
        )
