"""Hot pixels of a sensor, from the map of its calibration, and how searches and fits leave them out."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from processing.arrays import Floats, Ints
from processing.spot.fit_values import (
    AMPLITUDE,
    BACKGROUND,
    COVARIANCE,
    DISPLACEMENT_X,
    DISPLACEMENT_Y,
    HAS_SECOND,
    LAST,
    PARAMETERS,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    Image,
    Placement,
    X,
    Y,
)
from processing.spot.following import SEARCH
from processing.spot.outcome import FLAGS, Result

_MARGIN_PX = 2
"""Margin beyond the fit's window, smaller than that of a record, so that a replay fits the same pixels."""
_MAX_FITS = 5
_NEIGHBOURS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy)


class HotPixels:
    """Pixels (x, y) of the sensor whose values do not depend on the light.

    A fit that leaves out a pixel equals the fit in which the pixel has the value expected there. The value is
    found by filling in the expected one and fitting again until it does not change.
    """

    def __init__(self, pixels_xy: Sequence[tuple[int, int]]) -> None:
        self._y, self._x = np.array(sorted({(y, x) for x, y in pixels_xy}), dtype=np.int64).T

    def in_window(self, x0: int, y0: int, x1: int, y1: int) -> tuple[Ints, Ints] | None:
        """Rows and columns, from (x0, y0), of those in x0 <= x < x1, y0 <= y < y1; None without any."""
        first, last = np.searchsorted(self._y, (y0, y1))
        columns = self._x[first:last] - x0
        inside = (columns >= 0) & (columns < x1 - x0)
        return (self._y[first:last][inside] - y0, columns[inside]) if inside.any() else None

    def smoothed(self, image: Image, origin_px: tuple[int, int]) -> Image:
        """The image, hot pixels replaced by the mean of their neighbours: for searches and samples."""
        (ny, nx), (x0, y0) = image.shape, origin_px
        hot = self.in_window(x0, y0, x0 + nx, y0 + ny)
        if hot is None:
            return image
        rows, columns = hot
        indices = rows * nx + columns
        total, count = np.zeros((2, len(rows)))
        for dx, dy in _NEIGHBOURS:
            row, column = rows + dy, columns + dx
            is_good = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
            is_good &= ~np.isin(row * nx + column, indices)
            total[is_good] += image[row[is_good], column[is_good]]
            count += is_good
        filled: Image = image.copy()
        # a pixel within a cluster has no good neighbours: the smallest value stands for the background
        dark = float(image.min())
        filled[hot] = np.rint(np.where(count > 0, total / np.maximum(count, 1.0), dark)).astype(image.dtype)
        return filled

    def follow(
        self, image: Image, placement: Placement, memory: Floats, follow: Callable[[Image, Placement], Result]
    ) -> Result:
        """Result of the fit `follow` of the spot near its last position, without hot pixels."""
        spot = memory[LAST : LAST + PARAMETERS].copy()
        spot[[X, SECOND_X]] += memory[DISPLACEMENT_X]
        spot[[Y, SECOND_Y]] += memory[DISPLACEMENT_Y]
        reach_x, reach_y = (math.ceil(REACH * spot[k]) + _MARGIN_PX for k in (SIGMA_X, SIGMA_Y))
        x, y = round(spot[X]) - placement.origin_x, round(spot[Y]) - placement.origin_y
        left, top = max(x - reach_x, 0), max(y - reach_y, 0)
        right, bottom = min(x + reach_x + 1, image.shape[1]), min(y + reach_y + 1, image.shape[0])
        x0, y0 = placement.origin_x + left, placement.origin_y + top
        hot = self.in_window(x0, y0, placement.origin_x + right, placement.origin_y + bottom)
        if hot is None:
            return follow(image, placement)
        window = image[top:bottom, left:right].copy()
        memory_before = memory.copy()
        has_second = bool(memory[HAS_SECOND])
        expected_dn = partial(_expected_dn, has_second=has_second, rows=hot[0] + y0, columns=hot[1] + x0)
        for _ in range(_MAX_FITS):
            memory[:] = memory_before
            expected = np.rint(expected_dn(spot))
            window[hot] = np.clip(expected, 0, np.iinfo(window.dtype).max)
            result = follow(window, placement._replace(origin_x=x0, origin_y=y0))
            spot = memory[LAST : LAST + PARAMETERS].copy()
            if result[FLAGS] == SEARCH or np.array_equal(expected, np.rint(expected_dn(spot))):
                break
        return result


def _expected_dn(p: Floats, *, has_second: bool, rows: Ints, columns: Ints) -> Floats:
    """Expected values in DN of pixels of the sensor, of one spot or two."""
    determinant = (p[SIGMA_X] * p[SIGMA_Y]) ** 2 - p[COVARIANCE] ** 2
    xx, yy, xy = p[SIGMA_Y] ** 2 / determinant, p[SIGMA_X] ** 2 / determinant, -p[COVARIANCE] / determinant
    total = np.full(len(rows), p[BACKGROUND])
    spots = ((AMPLITUDE, X, Y), (SECOND_AMPLITUDE, SECOND_X, SECOND_Y))
    for amplitude, x, y in spots if has_second else spots[:1]:
        u, v = columns - p[x], rows - p[y]
        qx, qy = xx * u + xy * v, xy * u + yy * v  # as in `general_fit`
        bracket = 1.0 + (qx**2 - xx + qy**2 - yy) / 24.0
        total += p[amplitude] * bracket * np.exp(-0.5 * (u * qx + v * qy))
    return total
