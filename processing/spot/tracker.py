"""Follows the laser spot from frame to frame."""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import DataError
from processing.spot.batch import track_run
from processing.spot.following import SEARCH, follow
from processing.spot.general_fit import PARAMETERS
from processing.spot.outcome import STATE_SIZE, WORK_ROWS
from processing.spot.scan import BAND_ROWS, BAND_STEP, SAMPLES
from processing.spot.searching import search
from processing.spot.sensor_model import SensorModel
from processing.spot.spot import SPOT_DTYPE, Image, Spot, SpotFlag

_TABLE_WIDTH = 2048
_RECORD_REACH = 6.0
_RECORD_MARGIN_PX = 4
_RUN = 256
_TYPES = (np.dtype(np.uint8), np.dtype(np.uint16))
_SPOT = tuple.__new__


class _Writable:
    """A read-only array's memory without the mark, so that the kernels, which only read, compile once."""

    def __init__(self, image: Image) -> None:
        self._image = image
        interface = dict(image.__array_interface__)
        interface["data"] = (interface["data"][0], False)
        self.__array_interface__ = interface


def _plain(images: Image) -> Image:
    """C order, aligned, and of the one type that the kernels are compiled for."""
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
        self._sensor = sensor
        self._row_step = row_step
        self._state = np.zeros(STATE_SIZE)
        self._state[16:] = (
            sensor.variance_at_zero_dn2,
            1.0 / sensor.gain_e_per_dn,
            sensor.full_scale_dn,
            row_step,
            sensor.prnu**2,
        )
        self._work = np.zeros((WORK_ROWS, PARAMETERS))
        self._tables = np.zeros((6, _TABLE_WIDTH), dtype=np.float32)
        self._sample = np.zeros(SAMPLES, dtype=np.int64)
        self._mask = np.zeros((1, 1), dtype=np.uint8)
        self._stack = np.zeros(1, dtype=np.int64)
        self._bands: Image = np.zeros((1, 1), dtype=np.uint8)

    def reset(self) -> None:
        """Forget the last frame: the next one is searched as a whole."""
        # the rest of the state is not read before a search has set it
        self._state[0] = 0.0

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
        if self._state[0]:
            found = follow(image, x0, y0, nx, ny, self._state, self._work, self._tables)
            if found[10] != SEARCH:
                return _SPOT(Spot, found)
        if image.shape != self._mask.shape or image.dtype != self._bands.dtype:
            self._make_room(image.shape, image.dtype)
        found = search(
            image, x0, y0, nx, ny, self._state, self._work, self._tables,
            self._bands, self._sample, self._mask, self._stack,
        )  # fmt: skip
        return _SPOT(Spot, found)

    def track_stack(self, images: Image, *, threads: int = 1) -> NDArray[np.void]:
        """Spots of (n, ny, nx) images as rows of `SPOT_DTYPE`, each frame following the one before.

        The stack is cut into runs of 256 frames; each but the first begins with a search, so that the
        result is the same to the last bit for any number of `threads`. It agrees with frame-by-frame
        tracking within a small part of the standard uncertainty.

        Raises
        ------
        DataError
            Images that are not three-dimensional, not uint8 or uint16, or smaller than 5 x 5.
        """
        if images.ndim != 3 or images.dtype not in _TYPES:
            raise DataError(
                f"images have shape {images.shape} and type {images.dtype}; "
                "(n, ny, nx) of uint8 or uint16 is needed"
            )
        if threads < 1:
            raise DataError(f"threads = {threads} must be at least 1")
        if not images.flags.carray:
            images = _plain(images)
        runs = [images[start : start + _RUN] for start in range(0, len(images), _RUN)]
        if not runs:
            return np.empty(0, dtype=SPOT_DTYPE)

        def tracked(number: int) -> tuple[NDArray[np.void], NDArray[np.float64]]:
            # one tracker for each run: what a run leaves behind must not depend on the order they are done in
            tracker = self if number == 0 else SpotTracker(self._sensor, row_step=self._row_step)
            return tracker._track_run(runs[number]), tracker._state

        if threads == 1:
            parts = [tracked(number) for number in range(len(runs))]
        else:
            with ThreadPoolExecutor(threads) as pool:
                parts = list(pool.map(tracked, range(len(runs))))
        self._state[:] = parts[-1][1]
        return np.concatenate([spots for spots, _ in parts])

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

    def _track_run(self, images: Image) -> NDArray[np.void]:
        self._make_room(images.shape[1:], images.dtype)
        rows = np.empty((len(images), len(Spot._fields) - 1))
        flags = np.empty(len(images), dtype=np.int64)
        track_run(
            images, self._state, self._work, self._tables,
            self._bands, self._sample, self._mask, self._stack, rows, flags,
        )  # fmt: skip
        spots = np.empty(len(images), dtype=SPOT_DTYPE)
        for column, name in enumerate(Spot._fields[:-1]):
            spots[name] = rows[:, column]
        spots["flags"] = flags
        return spots

    def _make_room(self, shape: tuple[int, ...], dtype: np.dtype[np.uint8] | np.dtype[np.uint16]) -> None:
        if min(shape) < 5:
            raise DataError(f"image has shape {shape}; at least 5 x 5 pixels are needed")
        self._mask = np.zeros(shape, dtype=np.uint8)
        self._stack = np.zeros(self._mask.size, dtype=np.int64)
        rows = (shape[0] + BAND_ROWS - 1) // BAND_ROWS
        columns = (shape[1] + BAND_STEP - 1) // BAND_STEP * BAND_STEP + 2
        self._bands = np.zeros((rows, columns), dtype=dtype)
