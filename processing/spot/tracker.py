"""Tracking of the laser spot from frame to frame."""

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
    """Array interface to a read-only array's memory that does not declare it read-only.

    numba treats read-only arrays as a separate type and would compile every kernel a second time for them.
    The kernels do not write to the image.
    """

    def __init__(self, image: Image) -> None:
        self._image = image
        interface = dict(image.__array_interface__)
        interface["data"] = (interface["data"][0], False)
        self.__array_interface__ = interface


def _plain(images: Image) -> Image:
    """The image in C order, aligned, and of the array type that the kernels are compiled for."""
    if not (images.flags.c_contiguous and images.flags.aligned):
        return images.copy(order="C")
    memory: Any = _Writable(images)
    writable: Image = np.asarray(memory)
    return writable


class SpotTracker:
    """Maximum-likelihood position of the spot, with standard uncertainties and flags.

    An elliptical Gaussian, integrated over the pixels, is fitted by Fisher scoring with weights from the
    sensor's noise model. The start values are the previous frame's spot, displaced by its last movement.
    If the spot is not found there, the whole frame is searched.

    Parameters
    ----------
    sensor
        Noise and full scale of a pixel.
    row_step
        A search reads every `row_step`-th row first, and every row if that finds no clean spot. With 1,
        every row is read at once.

    Raises
    ------
    DataError
        A `row_step` below 1.
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
        """Forget the last frame, so that the next one is searched as a whole."""
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
            Sensor coordinates (x, y) of the image's first pixel, if the image is a window of the sensor.
            The returned position is in sensor coordinates.
        sensor_shape
            (ny, nx) of the sensor, so that the edges of a window are not taken for those of the sensor
            (flag EDGE). None: the image is the whole sensor.

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
        """Window x0 <= x < x1, y0 <= y < y1 of a frame that has to be recorded to fit this spot again later.

        Returns (x0, y0, x1, y1): the window of the fit and a margin, within the frame; for a lost spot
        the whole frame.
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
