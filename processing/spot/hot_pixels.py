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
    LAST,
    PARAMETERS,
    REACH,
    SECOND_AMPLITUDE,
    SECOND_X,
    SECOND_Y,
    SIGMA_X,
    SIGMA_Y,
    STEP_X,
    STEP_Y,
    TWO,
    Image,
    Place,
    X,
    Y,
)
from processing.spot.following import SEARCH
from processing.spot.outcome import FLAGS, Result

_MARGIN_PX = 2
"""Margin beyond the fit's window, smaller than that of a record, so that a replay fits the same pixels."""
_MOST_FITS = 5
_NEIGHBOURS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy)

Follow = Callable[[Image, Place], Result]


class HotPixels:
    """Pixels (x, y) of the sensor whose values do not depend on the light.

    A fit without a pixel equals the fit in which the pixel has the value that this fit expects there. It is
    found by filling in the expected value and fitting again until the value does not change.
    """

    def __init__(self, places: Sequence[tuple[int, int]]) -> None:
        at = sorted({(y, x) for x, y in places})
        self._y = np.array([y for y, _ in at], dtype=np.int64)
        self._x = np.array([x for _, x in at], dtype=np.int64)

    def in_window(self, x0: int, y0: int, x1: int, y1: int) -> tuple[Ints, Ints] | None:
        """Rows and columns, from (x0, y0), of those in x0 <= x < x1, y0 <= y < y1; None if there are none."""
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
        places = rows * nx + columns
        total, count = np.zeros((2, len(rows)))
        for dx, dy in _NEIGHBOURS:
            row, column = rows + dy, columns + dx
            good = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
            good &= ~np.isin(row * nx + column, places)
            total[good] += image[row[good], column[good]]
            count += good
        filled: Image = image.copy()
        # a pixel within a cluster has no good neighbours: the smallest value stands for the background
        dark = float(image.min())
        filled[hot] = np.rint(np.where(count > 0, total / np.maximum(count, 1.0), dark)).astype(image.dtype)
        return filled

    def follow(self, image: Image, place: Place, memory: Floats, follow: Follow) -> Result:
        """Result of the fit `follow` of the spot near its last place, without hot pixels."""
        spot = memory[LAST : LAST + PARAMETERS].copy()
        spot[[X, SECOND_X]] += memory[STEP_X]
        spot[[Y, SECOND_Y]] += memory[STEP_Y]
        reach_x, reach_y = (math.ceil(REACH * spot[k]) + _MARGIN_PX for k in (SIGMA_X, SIGMA_Y))
        x, y = round(spot[X]) - place.origin_x, round(spot[Y]) - place.origin_y
        left, top = max(x - reach_x, 0), max(y - reach_y, 0)
        right, bottom = min(x + reach_x + 1, image.shape[1]), min(y + reach_y + 1, image.shape[0])
        x0, y0 = place.origin_x + left, place.origin_y + top
        hot = self.in_window(x0, y0, place.origin_x + right, place.origin_y + bottom)
        if hot is None:
            return follow(image, place)
        cut = image[top:bottom, left:right].copy()
        before = memory.copy()
        light = partial(_expected_dn, two=bool(before[TWO]), rows=hot[0] + y0, columns=hot[1] + x0)
        for _ in range(_MOST_FITS):
            memory[:] = before
            expected = np.rint(light(spot))
            cut[hot] = np.clip(expected, 0, np.iinfo(cut.dtype).max)
            result = follow(cut, place._replace(origin_x=x0, origin_y=y0))
            spot = memory[LAST : LAST + PARAMETERS].copy()
            if result[FLAGS] == SEARCH or np.array_equal(expected, np.rint(light(spot))):
                break
        return result


def _expected_dn(p: Floats, *, two: bool, rows: Ints, columns: Ints) -> Floats:
    """Expected values in DN at places on the sensor, of one spot or two."""
    determinant = (p[SIGMA_X] * p[SIGMA_Y]) ** 2 - p[COVARIANCE] ** 2
    xx, yy, xy = p[SIGMA_Y] ** 2 / determinant, p[SIGMA_X] ** 2 / determinant, -p[COVARIANCE] / determinant
    total = np.full(len(rows), p[BACKGROUND])
    spots = ((AMPLITUDE, X, Y), (SECOND_AMPLITUDE, SECOND_X, SECOND_Y))
    for amplitude, x, y in spots if two else spots[:1]:
        u, v = columns - p[x], rows - p[y]
        along, across = xx * u + xy * v, xy * u + yy * v
        flat = 1.0 + (along**2 - xx + across**2 - yy) / 24.0
        total += p[amplitude] * flat * np.exp(-0.5 * (u * along + v * across))
    return total
