"""Tracking of the laser spot from frame to frame."""

import math
from typing import Any

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.spot.clean_fit import LARGEST_TABLE
from processing.spot.fit_values import (
    ALONE,
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    FOLLOWS,
    LAST,
    PARAMETERS,
    POOR_FRAMES,
    SIGMA_X,
    SIGMA_Y,
    STEP_X,
    STEP_Y,
    TILT_HINTS,
    TWO,
    WORKSPACE_SHAPE,
    Image,
    Place,
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
from processing.spot.start import AREAS, BLOCK, EVERY_ROW, SEEN, SOME_ROWS, find_start
from processing.spot.upright_score import TABLE_ROWS


class _Writable:
    """Array interface to the memory of a read-only array, without the mark that it is read-only.

    numba treats read-only arrays as a separate type and would compile every kernel a second time for them.
    The kernels do not write to the image.
    """

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
    """Working memory of a search in images of one shape and type."""

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


_RECORD_REACH = 6.0
_RECORD_MARGIN_PX = 4
"""Half-width of a recorded window, in sigmas of the spot, and pixels beyond, so that a replay can fit again
with the spot displaced."""
_NEAR_REACH = 6.0
_NEAR_MARGIN_PX = 16
_NEAR_STEP_PX = 32
"""A spot that has jumped is searched for within _NEAR_REACH sigmas and _NEAR_MARGIN_PX of its last place. The
window's size is a multiple of _NEAR_STEP_PX, so that the search's memory seldom changes its size."""
_ROW_STEP = 8
"""Step of the rows that a search reads first; it reads every row if it finds no clean spot in them."""
_COMPARED_PARAMETERS = (AMPLITUDE, SIGMA_X, SIGMA_Y)
"""Parameters that change by less than a factor of two when a spot jumps."""
_TYPES = (np.dtype(np.uint8), np.dtype(np.uint16))
_SPOT = tuple.__new__
_NOT_NEAR: Result = (*(math.nan,) * 10, SEARCH)
_LOST: Result = (*(math.nan,) * 10, SpotFlag.LOST.value)
_METHODS = SOME_ROWS, EVERY_ROW, AREAS, BLOCK


class SpotTracker:
    """Maximum-likelihood position of the spot, with standard uncertainties and flags.

    An elliptical Gaussian, integrated over the pixels, is fitted by Fisher scoring with weights from the
    sensor's noise model. The start values are the previous frame's spot, displaced by its last movement.
    If the spot is not there, it is searched for near its last place, then in the whole frame.

    Parameters
    ----------
    sensor
        Noise and full scale of a pixel, and the hot pixels, which are excluded from fits.
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._pixel_noise = sensor.pixel_noise
        self._noise = np.array(self._pixel_noise, dtype=np.float64)
        self._full_scale_dn = float(sensor.full_scale_dn)  # of one type, for which the search is compiled
        self._memory = empty_memory()
        self._work = np.zeros(WORKSPACE_SHAPE)
        self._tables = np.zeros((TABLE_ROWS, LARGEST_TABLE), dtype=np.float32)
        self._sample = np.zeros(SAMPLES, dtype=np.int64)
        self._seen = np.zeros(SEEN)
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
            (ny, nx) of the sensor, for the flag EDGE; None if the image is the whole sensor.

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
            return self._with_profile(self._follower, image, Place(x0, y0, nx, ny))
        if self._memory[FOLLOWS]:
            if self._hot is None:
                found = follow(
                    image, x0, y0, nx, ny, self._memory, self._work, self._tables, self._noise, EXPECTED
                )
            else:
                found = self._hot.follow(image, Place(x0, y0, nx, ny), self._memory, self._follow)
            if not found[FLAGS] and self._choice.model is not None:
                return _SPOT(Spot, found)
            if found[FLAGS] != SEARCH:
                spot = _SPOT(Spot, found)
                self._choose_model(spot, image, Place(x0, y0, nx, ny))
                return self._choice.with_width_error(spot)
            if self._memory[TWO] and self._choice.model is None:
                self._memory[ALONE] = 1.0  # the fit of two Gaussians could not be followed
        return self._choice.with_width_error(_SPOT(Spot, self._find(image, Place(x0, y0, nx, ny))))

    def _follow(self, image: Image, place: Place) -> Result:
        return follow(image, *place, self._memory, self._work, self._tables, self._noise, EXPECTED)

    def _find(self, image: Image, place: Place) -> Result:
        """Spot of a frame in which it is not at the expected place."""
        if self._hot is None:
            return self._find_in(image, place)
        memory = self._memory
        found = self._find_in(self._hot.smoothed(image, place[:2]), place)
        if not memory[FOLLOWS]:
            return found
        before = memory.copy()
        result = self._hot.follow(image, place, memory, self._follow)
        if result[FLAGS] == SEARCH:
            memory[:] = before
            return found
        memory[[STEP_X, STEP_Y]] = before[[STEP_X, STEP_Y]]
        return result

    def _find_in(self, image: Image, place: Place) -> Result:
        """Spot of such a frame, with all pixels used."""
        if self._memory[FOLLOWS]:
            found = self._follow_jump(image, place)
            if found[FLAGS] != SEARCH:
                return found
        if not self._frame.fits(image):
            self._frame = SearchMemory(image)
        return self._search(image, place, self._memory, self._frame, _ROW_STEP, False)

    def _with_profile(self, follower: ProfileFollower, image: Image, place: Place) -> Spot:
        """Spot of one frame with the learned profile; a Gaussian finds it away from the expected place."""
        found = follower.follow(image, place, self._memory) if self._memory[FOLLOWS] else None
        if found is None:
            spot = _SPOT(Spot, self._find(image, place))
            found = follower.follow(image, place, self._memory, fresh=True) if self._memory[FOLLOWS] else None
            return spot if found is None else found
        self._choose_model(found, image, place)
        return found

    def _choose_model(self, spot: Spot, image: Image, place: Place) -> None:
        """Choose the model from the first spots; choose again if the beam has changed."""
        choice, memory = self._choice, self._memory
        if choice.model is not None:
            if choice.changed(spot.chi2_per_dof, memory[POOR_FRAMES]):
                choice.restart()
                self._follower = None
                memory[ALONE] = 0.0
                self.reset()
            return

        def window() -> tuple[Image, tuple[int, int]]:
            x0, y0, x1, y1 = self.record_window(spot, (place.sensor_ny, place.sensor_nx))
            left, top = max(x0 - place.origin_x, 0), max(y0 - place.origin_y, 0)
            cut: Image = image[top : y1 - place.origin_y, left : x1 - place.origin_x].copy()
            origin_px = left + place.origin_x, top + place.origin_y
            return cut if self._hot is None else self._hot.smoothed(cut, origin_px), origin_px

        choice.add(spot, window)
        if choice.model is not None:
            memory[ALONE] = 0.0 if choice.model is SpotModel.TWO else 1.0
            memory[POOR_FRAMES] = 0.0
            if choice.profile is not None:
                self._follower = ProfileFollower(choice.profile, self._pixel_noise, self._hot)
                memory[TWO] = 0.0

    def _one_gaussian(self, image: Image, origin_px: tuple[int, int]) -> tuple[Floats, Shape] | None:
        """Fit of a single Gaussian to a window (`Refit`)."""
        memory = empty_memory()
        memory[ALONE] = 1.0
        place = Place(*origin_px, 2**30, 2**30)
        found = self._search(image, place, memory, SearchMemory(image), 1, False)
        if found[FLAGS] & SpotFlag.LOST:
            return None
        last = memory[LAST : LAST + PARAMETERS]
        shape = Shape(last[SIGMA_X] ** 2, last[SIGMA_Y] ** 2, last[COVARIANCE])
        return last[[X, Y, AMPLITUDE, BACKGROUND]], shape

    def _follow_jump(self, image: Image, place: Place) -> Result:
        """Spot of a frame in which it is not at the expected place, but may be near its last one.

        A search there gives the start values of the fit. The spot found must resemble the last one: it could
        be a reflection while the spot is further away.
        """
        last = self._memory[LAST : LAST + PARAMETERS].copy()
        reach_px = _NEAR_REACH * max(last[SIGMA_X], last[SIGMA_Y]) + _NEAR_MARGIN_PX
        side = _NEAR_STEP_PX * math.ceil(2 * reach_px / _NEAR_STEP_PX)
        height, width = min(side, image.shape[0]), min(side, image.shape[1])
        left = min(max(round(last[X] - place.origin_x) - width // 2, 0), image.shape[1] - width)
        top = min(max(round(last[Y] - place.origin_y) - height // 2, 0), image.shape[0] - height)
        near = image[top : top + height, left : left + width].copy()
        if not self._near.fits(near):
            self._near = SearchMemory(near)
        around = place._replace(origin_x=place.origin_x + left, origin_y=place.origin_y + top)
        self._search(near, around, self._memory, self._near, 1, True)
        found = self._memory[LAST : LAST + PARAMETERS]
        if not self._memory[FOLLOWS] or not all(0.5 < found[k] / last[k] < 2.0 for k in _COMPARED_PARAMETERS):
            return _NOT_NEAR
        result = self._follow(image, place)
        self._memory[STEP_X] = found[X] - last[X]
        self._memory[STEP_Y] = found[Y] - last[Y]
        return result

    def _search(
        self, image: Image, place: Place, memory: Floats, arrays: SearchMemory, row_step: int, cut_out: bool
    ) -> Result:
        """Spot of an image without knowledge of earlier ones; LOST if there is none.

        An image that is `cut_out` of a frame may contain the flank of a spot outside it: near its edge the
        last two methods, which take long, are not tried.
        """
        memory[TILT_HINTS] = 0.0
        for method in _METHODS if row_step > 1 else _METHODS[1:]:
            if not find_start(
                image, method, row_step, self._full_scale_dn, self._work[0], self._seen,
                arrays.bands, self._sample, arrays.mask, arrays.stack,
            ):  # fmt: skip
                continue
            start = NEAR if method < AREAS else ROUGH
            if cut_out and start == ROUGH and _near_edge(image.shape, self._work[0]):
                break
            found = follow(image, *place, memory, self._work, self._tables, self._noise, start)
            if found[FLAGS] != SEARCH:
                return found
        memory[[FOLLOWS, STEP_X, STEP_Y]] = 0.0
        return _LOST

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


def _near_edge(shape: tuple[int, ...], p: Floats) -> bool:
    """Whether the image's edge is nearer to the spot than two standard deviations."""
    edge_x, edge_y = min(p[X], shape[1] - 1 - p[X]), min(p[Y], shape[0] - 1 - p[Y])
    return bool(edge_x < 2.0 * p[SIGMA_X] or edge_y < 2.0 * p[SIGMA_Y])
