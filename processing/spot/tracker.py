"""Follows the laser spot from frame to frame."""

import math
from typing import Any

import numpy as np

from processing.errors import DataError
from processing.spot.fit_values import WORKSPACE_SHAPE
from processing.spot.following import SEARCH, follow
from processing.spot.memory import FOLLOWS, empty_memory
from processing.spot.scan import BAND_ROWS, BAND_STEP, SAMPLES
from processing.spot.searching import search
from processing.spot.sensor_model import SensorModel
from processing.spot.spot import Image, Spot, SpotFlag
from processing.spot.upright_fit import LARGEST_TABLE
from processing.spot.upright_score import TABLE_ROWS

_RECORD_REACH = 6.0
_RECORD_MARGIN_PX = 4
_TYPES = (np.dtype(np.uint8), np.dtype(np.uint16))
_SPOT = tuple.__new__


class _Writable:
    """A read-only array's memory without the read-only mark.

    To numba a read-only array is a type of its own, for which it would compile every kernel a second time.
    """

    def __init__(self, image: Image) -> None:
        self._image = image
        interface = dict(image.__array_interface__)
        interface["data"] = (interface["data"][0], False)
        self.__array_interface__ = interface


def _plain(images: Image) -> Image:
    """The image in C order, aligned, and of the one type that the kernels are compiled for."""
    if not (images.flags.c_contiguous and images.flags.aligned):
        return images.copy(order="C")
    memory: Any = _Writable(images)
    writable: Image = np.asarray(memory)
    return writable


class SpotTracker:
    """Maximum-likelihood position of the spot, with standard uncertainties and flags.

    An elliptical Gaussian, integrated over the pixels, is fitted by Fisher scoring with the weights of
    the sensor's noise, started from the last frame and the spot's last step. A frame in which the
    spot is not where it should be is searched as a whole.

    Parameters
    ----------
    sensor
        Noise and full scale of a pixel.
    row_step
        The search reads every `row_step`-th row first, and all of them where that gives no clean spot; 1
        reads all from the start.
    """

    def __init__(self, sensor: SensorModel, *, row_step: int = 8) -> None:
        if row_step < 1:
            raise DataError(f"row_step = {row_step} must be at least 1")
        self._row_step = row_step
        self._noise = np.array(sensor.pixel_noise, dtype=np.float64)
        self._memory = empty_memory()
        self._work = np.zeros(WORKSPACE_SHAPE)
        self._tables = np.zeros((TABLE_ROWS, LARGEST_TABLE), dtype=np.float32)
        self._sample = np.zeros(SAMPLES, dtype=np.int64)
        self._mask = np.zeros((1, 1), dtype=np.uint8)
        self._stack = np.zeros(1, dtype=np.int64)
        self._bands: Image = np.zeros((1, 1), dtype=np.uint8)

    def reset(self) -> None:
        """Forget the last frame: the next one is searched as a whole."""
        self._memory[FOLLOWS] = 0.0

    def track(
        self, image: Image, origin_px: tuple[int, int] = (0, 0), sensor_shape: tuple[int, int] | None = None
    ) -> Spot:
        """Spot of one frame.

        Parameters
        ----------
        image
            Shape (ny, nx), uint8 or uint16.
        origin_px
            Sensor coordinates (x, y) of the image's first pixel, where the image is a window cut out of
            the sensor; positions come out in sensor coordinates.
        sensor_shape
            (ny, nx) of the sensor; a window's own edges then do not count as the sensor's.

        Raises
        ------
        DataError
            An image that is not two-dimensional, not uint8 or uint16, or smaller than 5 x 5.
        """
        if image.ndim != 2 or image.dtype not in _TYPES:
            raise DataError(
                f"image has shape {image.shape} and type {image.dtype}; (ny, nx) of uint8 or uint16 is needed"
            )
        if not image.flags.carray:
            image = _plain(image)
        x0, y0 = origin_px
        ny, nx = sensor_shape if sensor_shape is not None else image.shape
        if self._memory[FOLLOWS]:
            found = follow(image, x0, y0, nx, ny, self._memory, self._work, self._tables, self._noise)
            if found[10] != SEARCH:
                return _SPOT(Spot, found)
        if image.shape != self._mask.shape or image.dtype != self._bands.dtype:
            self._make_room(image.shape, image.dtype)
        found = search(
            image, x0, y0, nx, ny, self._memory, self._work, self._tables, self._noise, self._row_step,
            self._bands, self._sample, self._mask, self._stack,
        )  # fmt: skip
        return _SPOT(Spot, found)

    def record_window(self, spot: Spot, shape: tuple[int, int]) -> tuple[int, int, int, int]:
        """Pixels (x0, y0, x1, y1) of a frame from which this spot can be tracked again.

        The fit's window and a margin, cut at the frame's edges; the whole frame for a lost spot.
        """
        ny, nx = shape
        if spot.flags & SpotFlag.LOST:
            return 0, 0, nx, ny
        c, s = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
        half_x = math.hypot(spot.sigma_x_px * c, spot.sigma_y_px * s)
        half_y = math.hypot(spot.sigma_x_px * s, spot.sigma_y_px * c)
        reach_x = math.ceil(_RECORD_REACH * half_x) + _RECORD_MARGIN_PX
        reach_y = math.ceil(_RECORD_REACH * half_y) + _RECORD_MARGIN_PX
        x, y = round(spot.x_px), round(spot.y_px)
        return max(0, x - reach_x), max(0, y - reach_y), min(nx, x + reach_x + 1), min(ny, y + reach_y + 1)

    def _make_room(self, shape: tuple[int, ...], dtype: np.dtype[np.uint8] | np.dtype[np.uint16]) -> None:
        if min(shape) < 5:
            raise DataError(f"image has shape {shape}; at least 5 x 5 pixels are needed")
        self._mask = np.zeros(shape, dtype=np.uint8)
        self._stack = np.zeros(self._mask.size, dtype=np.int64)
        rows = (shape[0] + BAND_ROWS - 1) // BAND_ROWS
        columns = (shape[1] + BAND_STEP - 1) // BAND_STEP * BAND_STEP + 2
        self._bands = np.zeros((rows, columns), dtype=dtype)
