"""Tracking of the laser spot from frame to frame."""

import math
from typing import Any

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.spot.clean_fit import LARGEST_TABLE
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    DISPLACEMENT_X,
    DISPLACEMENT_Y,
    HAS_LAST_SPOT,
    HAS_SECOND,
    LAST,
    PARAMETERS,
    POOR_FRAMES,
    SIGMA_X,
    SIGMA_Y,
    SINGLE_ONLY,
    TILT_HINTS,
    WORKSPACE_SHAPE,
    Image,
    Placement,
    Spot,
    SpotFlag,
    X,
    Y,
    empty_memory,
)
from processing.spot.following import EXPECTED, NEAR, ROUGH, SEARCH, follow
from processing.spot.hot_pixels import HotPixels
from processing.spot.model_choice import ModelChoice, SpotModel
from processing.spot.outcome import FLAGS, Result
from processing.spot.profile import Shape
from processing.spot.profile_follower import ProfileFollower
from processing.spot.scan import BAND_ROWS, BAND_STEP, SAMPLES
from processing.spot.sensor_model import SensorModel
from processing.spot.start import AREAS, BLOCK, EVERY_ROW, SEARCH_VALUES, SOME_ROWS, find_start
from processing.spot.upright_score import TABLE_ROWS


class _Writable:
    """Array interface to a read-only array's memory without the mark that it is read-only: for such arrays
    numba would compile every kernel again. The kernels do not write to the image."""

    def __init__(self, image: Image) -> None:
        self._image = image
        interface = dict(image.__array_interface__)
        interface["data"] = (interface["data"][0], False)
        self.__array_interface__ = interface


def kernel_image(images: Image) -> Image:
    """Image in C order, aligned, and of the array type for which the kernels are compiled."""
    if not (images.flags.c_contiguous and images.flags.aligned):
        return images.copy(order="C")
    memory: Any = _Writable(images)
    writable: Image = np.asarray(memory)
    return writable


class SearchMemory:
    """Working memory of a search in images of the same shape and type."""

    def __init__(self, image: Image) -> None:
        ny, nx = image.shape
        if min(ny, nx) < 5:
            raise DataError(f"image has shape {image.shape}; at least 5 x 5 pixels are needed")
        self.mask = np.zeros((ny, nx), dtype=np.uint8)
        self.stack = np.zeros(ny * nx, dtype=np.int64)
        rows = (ny + BAND_ROWS - 1) // BAND_ROWS
        columns = (nx + BAND_STEP - 1) // BAND_STEP * BAND_STEP + 2
        self.bands: Image = np.zeros((rows, columns), dtype=image.dtype)

    def fits(self, image: Image) -> bool:
        """Whether this memory has the shape and type of an image."""
        return image.shape == self.mask.shape and image.dtype == self.bands.dtype


_RECORD_REACH_SIGMA = 6.0
"""Half-width of a recorded window in standard deviations of the spot."""
_RECORD_MARGIN_PX = 4
"""Pixels beyond that half-width, so that a replay can fit again with the spot displaced."""
_NEAR_REACH_SIGMA = 6.0
"""Half-width in standard deviations of the window about the last position in which a spot that has jumped is
searched for."""
_NEAR_MARGIN_PX = 16
"""Pixels beyond that half-width."""
_NEAR_SIZE_STEP_PX = 32
"""Number of which the size of that window is a multiple, so that the search's memory seldom changes size."""
_ROW_STEP = 8
"""Spacing of the rows that a search reads first; it reads every row if it finds no clean spot in them."""
_NO_EDGE_PX = 2**30
"""Size of a sensor whose edge no spot reaches: the flag EDGE is never set."""
_COMPARED_PARAMETERS = (AMPLITUDE, SIGMA_X, SIGMA_Y)
"""Parameters that change by less than a factor of two when a spot jumps."""
_TYPES = (np.dtype(np.uint8), np.dtype(np.uint16))
# makes a `Spot` of a tuple without a call of its constructor, which would take time in every frame
_SPOT = tuple.__new__
_NOT_NEAR: Result = (*(math.nan,) * 10, SEARCH)
_LOST: Result = (*(math.nan,) * 10, SpotFlag.LOST.value)
_METHODS = SOME_ROWS, EVERY_ROW, AREAS, BLOCK


class SpotTracker:
    """Maximum-likelihood position of the spot, with standard uncertainties and flags.

    An elliptical Gaussian, integrated over the pixels, is fitted by Fisher scoring with weights from the
    sensor's noise model. The start values are the previous frame's spot, displaced by its last movement.
    If the spot is not there, it is searched for near its last position, then in the whole frame. The sensor's
    hot pixels are excluded from fits.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._pixel_noise = sensor.pixel_noise
        self._noise = np.array(self._pixel_noise, dtype=np.float64)
        self._full_scale_dn = float(sensor.full_scale_dn)  # of one type, for which the search is compiled
        self._memory = empty_memory()
        self._work = np.zeros(WORKSPACE_SHAPE)
        self._tables = np.zeros((TABLE_ROWS, LARGEST_TABLE), dtype=np.float32)
        self._sample = np.zeros(SAMPLES, dtype=np.int64)
        self._search_values = np.zeros(SEARCH_VALUES)
        self._frame = self._near = SearchMemory(np.zeros((5, 5), dtype=np.uint8))
        self._hot = HotPixels(sensor.hot_pixels_xy) if sensor.hot_pixels_xy else None
        self._choice = ModelChoice(self._pixel_noise, self._one_gaussian)
        self._follower: ProfileFollower | None = None

    @property
    def model(self) -> SpotModel | None:
        """Model of the beam that is fitted to every frame; None as long as it is not chosen."""
        return self._choice.model

    def reset(self) -> None:
        """Forget the last frame, so that the next one is searched as a whole."""
        self._memory[HAS_LAST_SPOT] = 0.0

    def track(
        self, image: Image, origin_px: tuple[int, int] = (0, 0), sensor_shape: tuple[int, int] | None = None
    ) -> Spot:
        """Spot of one frame.

        Parameters
        ----------
        image : (ny, nx) uint8 or uint16, DN
        origin_px : sensor coordinates (x, y) of the image's first pixel; the spot has sensor coordinates, too
        sensor_shape : (ny, nx) of the sensor, for the flag EDGE; None if the image is the whole sensor

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
            image = kernel_image(image)
        x0, y0 = origin_px
        ny, nx = sensor_shape if sensor_shape is not None else image.shape
        if self._follower is not None:
            return self._with_profile(self._follower, image, Placement(x0, y0, nx, ny))
        if self._memory[HAS_LAST_SPOT]:
            if self._hot is None:
                result = follow(
                    image, x0, y0, nx, ny, self._memory, self._work, self._tables, self._noise, EXPECTED
                )
            else:
                result = self._hot.follow(image, Placement(x0, y0, nx, ny), self._memory, self._follow)
            if not result[FLAGS] and self._choice.model is not None:
                return _SPOT(Spot, result)
            if result[FLAGS] != SEARCH:
                spot = _SPOT(Spot, result)
                self._choose_model(spot, image, Placement(x0, y0, nx, ny))
                return self._choice.with_width_error(spot)
            if self._memory[HAS_SECOND] and self._choice.model is None:
                self._memory[SINGLE_ONLY] = 1.0  # the fit of two Gaussians could not be followed
        result = self._search_without_hot_pixels(image, Placement(x0, y0, nx, ny))
        return self._choice.with_width_error(_SPOT(Spot, result))

    def _follow(self, image: Image, placement: Placement) -> Result:
        return follow(image, *placement, self._memory, self._work, self._tables, self._noise, EXPECTED)

    def _search_without_hot_pixels(self, image: Image, placement: Placement) -> Result:
        """Spot of a frame in which it is not at the expected position."""
        if self._hot is None:
            return self._search_all_pixels(image, placement)
        memory = self._memory
        smoothed_result = self._search_all_pixels(self._hot.smoothed(image, placement[:2]), placement)
        if not memory[HAS_LAST_SPOT]:
            return smoothed_result
        memory_after_search = memory.copy()
        result = self._hot.follow(image, placement, memory, self._follow)
        if result[FLAGS] == SEARCH:
            memory[:] = memory_after_search
            return smoothed_result
        memory[[DISPLACEMENT_X, DISPLACEMENT_Y]] = memory_after_search[[DISPLACEMENT_X, DISPLACEMENT_Y]]
        return result

    def _search_all_pixels(self, image: Image, placement: Placement) -> Result:
        """Spot found by a search near the last position, then in the whole frame."""
        if self._memory[HAS_LAST_SPOT]:
            result = self._follow_jump(image, placement)
            if result[FLAGS] != SEARCH:
                return result
        if not self._frame.fits(image):
            self._frame = SearchMemory(image)
        return self._search(image, placement, self._memory, self._frame, _ROW_STEP, False)

    def _with_profile(self, follower: ProfileFollower, image: Image, placement: Placement) -> Spot:
        """Spot of one frame with the learned profile; a Gaussian finds it away from the expected position."""
        memory = self._memory
        if memory[HAS_LAST_SPOT]:
            spot = follower.follow(image, placement, memory)
            if spot is not None:
                self._choose_model(spot, image, placement)
                return spot
        gaussian: Spot = _SPOT(Spot, self._search_without_hot_pixels(image, placement))
        if not memory[HAS_LAST_SPOT]:
            return gaussian
        return follower.follow(image, placement, memory, has_this_spot=True) or gaussian

    def _choose_model(self, spot: Spot, image: Image, placement: Placement) -> None:
        """Choose the model from the first spots; choose again if the beam has changed."""
        choice, memory = self._choice, self._memory
        if choice.model is not None:
            if choice.changed(spot.chi2_per_dof, memory[POOR_FRAMES]):
                choice.restart()
                self._follower = None
                memory[SINGLE_ONLY] = 0.0
                self.reset()
            return

        def sample() -> tuple[Image, tuple[int, int]]:
            x0, y0, x1, y1 = self.record_window(spot, (placement.sensor_ny, placement.sensor_nx))
            left, top = max(x0 - placement.origin_x, 0), max(y0 - placement.origin_y, 0)
            window: Image = image[top : y1 - placement.origin_y, left : x1 - placement.origin_x].copy()
            origin_px = left + placement.origin_x, top + placement.origin_y
            return window if self._hot is None else self._hot.smoothed(window, origin_px), origin_px

        choice.add(spot, sample)
        if choice.model is not None:
            memory[SINGLE_ONLY] = 0.0 if choice.model is SpotModel.TWO else 1.0
            memory[POOR_FRAMES] = 0.0
            if choice.profile is not None:
                self._follower = ProfileFollower(choice.profile, self._pixel_noise, self._hot)
                memory[HAS_SECOND] = 0.0

    def _one_gaussian(self, image: Image, origin_px: tuple[int, int]) -> tuple[Floats, Shape] | None:
        """Fit of a single Gaussian to a window: the `refit` of `ModelChoice`."""
        memory = empty_memory()
        memory[SINGLE_ONLY] = 1.0
        placement = Placement(*origin_px, _NO_EDGE_PX, _NO_EDGE_PX)
        if self._search(image, placement, memory, SearchMemory(image), 1, False)[FLAGS] & SpotFlag.LOST:
            return None
        last = memory[LAST : LAST + PARAMETERS]
        shape = Shape(last[SIGMA_X] ** 2, last[SIGMA_Y] ** 2, last[COVARIANCE])
        return last[[X, Y, AMPLITUDE, BACKGROUND]], shape

    def _follow_jump(self, image: Image, placement: Placement) -> Result:
        """Spot near its last position of a frame in which it is not at the expected one. It must resemble the
        last one: it could be a reflection while the laser spot is further away."""
        last = self._memory[LAST : LAST + PARAMETERS].copy()
        reach_px = _NEAR_REACH_SIGMA * max(last[SIGMA_X], last[SIGMA_Y]) + _NEAR_MARGIN_PX
        size = _NEAR_SIZE_STEP_PX * math.ceil(2 * reach_px / _NEAR_SIZE_STEP_PX)
        height, width = min(size, image.shape[0]), min(size, image.shape[1])
        left = min(max(round(last[X] - placement.origin_x) - width // 2, 0), image.shape[1] - width)
        top = min(max(round(last[Y] - placement.origin_y) - height // 2, 0), image.shape[0] - height)
        window = image[top : top + height, left : left + width].copy()
        if not self._near.fits(window):
            self._near = SearchMemory(window)
        window_placement = placement._replace(
            origin_x=placement.origin_x + left, origin_y=placement.origin_y + top
        )
        self._search(window, window_placement, self._memory, self._near, 1, True)
        new = self._memory[LAST : LAST + PARAMETERS]
        if not self._memory[HAS_LAST_SPOT] or not all(
            0.5 < new[k] / last[k] < 2.0 for k in _COMPARED_PARAMETERS
        ):
            return _NOT_NEAR
        result = self._follow(image, placement)
        self._memory[DISPLACEMENT_X] = new[X] - last[X]
        self._memory[DISPLACEMENT_Y] = new[Y] - last[Y]
        return result

    def _search(
        self,
        image: Image,
        placement: Placement,
        memory: Floats,
        arrays: SearchMemory,
        row_step: int,
        is_window: bool,
    ) -> Result:
        """Spot of an image without knowledge of earlier ones; LOST if there is none. Near the edge of a
        window (`is_window`), with only the flank of a spot outside, the slow methods are not tried."""
        memory[TILT_HINTS] = 0.0
        for method in _METHODS if row_step > 1 else _METHODS[1:]:
            if not find_start(
                image, method, row_step, self._full_scale_dn, self._work[0], self._search_values,
                arrays.bands, self._sample, arrays.mask, arrays.stack,
            ):  # fmt: skip
                continue
            start = NEAR if method < AREAS else ROUGH
            x, y, sigma_x, sigma_y = self._work[0, [X, Y, SIGMA_X, SIGMA_Y]]
            edge_x, edge_y = min(x, image.shape[1] - 1 - x), min(y, image.shape[0] - 1 - y)
            if is_window and start == ROUGH and (edge_x < 2.0 * sigma_x or edge_y < 2.0 * sigma_y):
                break
            result = follow(image, *placement, memory, self._work, self._tables, self._noise, start)
            if result[FLAGS] != SEARCH:
                return result
        memory[[HAS_LAST_SPOT, DISPLACEMENT_X, DISPLACEMENT_Y]] = 0.0
        return _LOST

    @staticmethod
    def record_window(spot: Spot, shape: tuple[int, int]) -> tuple[int, int, int, int]:
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
        reach_x = math.ceil(_RECORD_REACH_SIGMA * half_x) + _RECORD_MARGIN_PX
        reach_y = math.ceil(_RECORD_REACH_SIGMA * half_y) + _RECORD_MARGIN_PX
        x, y = round(spot.x_px), round(spot.y_px)
        return max(0, x - reach_x), max(0, y - reach_y), min(nx, x + reach_x + 1), min(ny, y + reach_y + 1)
