"""Recorded frames as a `Camera`: in order, on demand, without losses."""

import logging
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
    Frame,
    Image,
    refuse_unsupported,
)
from acquisition.cameras.files.frame_source import FilesSettings, StoredImage, UnreadableFrame, frame_times
from acquisition.cameras.files.sources import open_source
from acquisition.cameras.reading import CameraRun, DeviceCamera
from processing.errors import DeviceError

_log = logging.getLogger(__name__)


class FilesCamera(DeviceCamera["RecordedFrames"]):
    """A `Camera` that plays recorded frames from the first to the last.

    Each `start` begins at the first frame, or, after the disk or share was lost, at the next one, with its
    own number. A frame that cannot be read, or has another size than the first, is skipped, counted in
    ``status.incomplete``, logged, and leaves a gap in the sequence; ``status.dropped_by_camera`` are gaps in
    the numbers of the timestamps file. The timestamps serve as the camera's clock. Exposure and gain are
    unknown (`configure` returns None), the bit depth is fixed. A region of interest is cut out.
    """

    def __init__(self, settings: FilesSettings) -> None:
        super().__init__(str(settings.path))
        self._settings = settings
        self._next_index = 0
        self._skipped: list[tuple[int, str]] = []
        self.remarks: Sequence[str] = ()
        self.lossy = ""
        self.pixel_aspect = 1.0

    def open(self) -> CameraInfo:
        """Find the frames and their times; reads the first frame that can be read."""
        if self._features is not None:
            return self._features.info
        frames = self._features = RecordedFrames(self._settings)
        source = frames.source
        if source.lossy:
            _log.warning(
                "%s: the codec %s is usually lossy, which makes positions less accurate",
                self._name,
                source.lossy,
            )
        for line in source.warnings:
            _log.warning("%s: %s", self._name, line)
        self.lossy, self.pixel_aspect = source.lossy, source.pixel_aspect
        self.remarks = [*filter(None, [source.summary]), *source.warnings]
        return frames.info

    @property
    def count(self) -> int:
        """Number of frames in the source."""
        return 0 if self._features is None else self._features.source.count

    def start(self) -> None:
        with self._lock:
            frames = self._open_device()
            self._must_be_idle()
            if not self._was_lost:
                self._next_index = 0
            numbers, index = self._begin(), self._next_index
            # gaps are counted from the frame before the first
            numbers.number(frames.times.sequence[index - 1] if index else -1, "dropped_by_camera")
            self._run = CameraRun(lambda _: self._next(frames), lambda: None)

    def _next(self, frames: "RecordedFrames") -> Frame | None:
        """Next frame that can be read; None, and the end of the run, after the last."""
        run = self._run
        assert run is not None
        while not run.stopped:
            index = self._next_index
            if index >= frames.source.count:
                self._log_skipped(frames)
                if not self.status.delivered:
                    raise DeviceError(f"{self._name}: none of the {index} frames can be read")
                run.request_stop()
                return None
            try:
                image = frames.image(index)
            except UnreadableFrame as error:
                self._numbers.lost_parts += 1
                self._skipped.append((index, str(error)))
                self._next_index += 1
                continue
            except OSError as error:
                raise CameraLost(f"{self._name}: is no longer available: {error.strerror}") from None
            self._next_index += 1
            self._log_skipped(frames)
            number = frames.times.sequence[index]
            self._numbers.number(number, "dropped_by_camera")
            return Frame(image, number, frames.times.time_ns[index], time.monotonic_ns())
        return None

    def _log_skipped(self, frames: "RecordedFrames") -> None:
        """Log one line on consecutive frames that were skipped."""
        if self._skipped:
            (first, reason), (last, _) = self._skipped[0], self._skipped[-1]
            label = frames.source.label
            more = f" and {len(self._skipped) - 1} more, to {label(last)}" if last > first else ""
            _log.warning("%s%s: skipped: %s", label(first), more, reason)
            self._skipped.clear()

    def close(self) -> None:
        self.stop()
        with self._lock:
            frames, self._features = self._features, None
            if frames is not None:
                self._when_idle(frames.source.close)


class RecordedFrames:
    """The frames of an open source, as grey images of one size and depth, with their times."""

    def __init__(self, settings: FilesSettings) -> None:
        self._settings = settings
        self._region: tuple[slice, slice] | None = None
        self.source = open_source(settings.path)
        self.times = frame_times(settings, self.source)
        image, full_scale_dn, self._first_label = self._first_image()
        self._dtype, self._shape = image.dtype, image.shape
        self.info = CameraInfo(
            driver="files",
            vendor="",
            model=settings.path.name,
            serial=str(settings.path),
            width_px=image.shape[1],
            height_px=image.shape[0],
            full_scale_dn=full_scale_dn,
            has_clock=True,
            stamped="middle",
        )

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set the region of interest; return the settings that apply."""
        info = self.info
        refuse_unsupported(settings, info.serial)
        x0, y0 = settings.offset_x_px or 0, settings.offset_y_px or 0
        width = settings.width_px or info.width_px - x0
        height = settings.height_px or info.height_px - y0
        if not 0 < width <= info.width_px - x0 or not 0 < height <= info.height_px - y0:
            raise DeviceError(
                f"{info.serial}: a region of {width}x{height} px at ({x0}, {y0}) does not lie in images of "
                f"{info.width_px}x{info.height_px} px"
            )
        is_full_image = (x0, y0, width, height) == (0, 0, info.width_px, info.height_px)
        self._region = None if is_full_image else np.s_[y0 : y0 + height, x0 : x0 + width]
        return CameraSettings(
            frame_rate_hz=self._settings.frame_rate_hz,
            pixel_format=FORMAT_OF_BITS.get(info.full_scale_dn.bit_length()),
            width_px=width,
            height_px=height,
            offset_x_px=x0,
            offset_y_px=y0,
        )

    def _first_image(self) -> tuple[Image, int, str]:
        """The first image that can be read, its full scale and its label."""
        source, reasons = self.source, []
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

    def image(self, index: int) -> Image:
        """The region of a frame. Raises UnreadableFrame for a damaged one, OSError if it is out of reach."""
        label = self.source.label(index)
        image, _ = self._grey(self.source.read(index), label)
        if image.dtype != self._dtype:
            raise DeviceError(
                f"{label}: its pixels are {image.dtype}, those of {self._first_label} are "
                f"{self._dtype}; convert them to one depth"
            )
        if image.shape != self._shape:
            raise UnreadableFrame(
                f"is {image.shape[1]}x{image.shape[0]} px, {self._first_label} is "
                f"{self._shape[1]}x{self._shape[0]} px"
            )
        return image if self._region is None else image[self._region].copy()

    def _grey(self, stored: StoredImage, label: str) -> tuple[Image, int]:
        """One channel of a frame at the requested bit depth, and its full scale."""
        pixels, full_scale, coloured = stored
        if coloured and self._settings.colour != "brightness":
            raise DeviceError(
                f"{label}: is in colour, with the luminance apart; to use the luminance as it is stored, "
                "state camera.files.colour = 'brightness'"
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
