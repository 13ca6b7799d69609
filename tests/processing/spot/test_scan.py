"""The vectorised passes over a whole frame agree with a few lines of numpy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.spot.scan import (
    BAND_ROWS,
    BAND_STEP,
    SAMPLES,
    background_of,
    brightest,
    scan_every_row,
    scan_some_rows,
)

Image = NDArray[np.uint8] | NDArray[np.uint16]
# a block is 64 pixels wide, a band 32 rows high, a group four: below, at and above each
HEIGHTS = (5, 6, 7, 31, 32, 33, 35, 64, 100)
WIDTHS = (5, 17, 63, 64, 65, 127, 128, 130, 255, 256, 257, 300)


def noise(ny: int, nx: int, kind: type[np.unsignedinteger]) -> Image:
    return np.random.default_rng([ny, nx]).integers(0, np.iinfo(kind).max, (ny, nx)).astype(kind)


def bands_for(image: Image) -> Image:
    ny, nx = image.shape
    return np.zeros((-(-ny // BAND_ROWS), -(-nx // BAND_STEP) * BAND_STEP + 2), dtype=image.dtype)


def rows_of(band: int, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    return rows[(rows >= band * BAND_ROWS) & (rows < (band + 1) * BAND_ROWS)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("ny", HEIGHTS)
def test_every_row(ny: int, kind: type[np.unsignedinteger]) -> None:
    for nx in WIDTHS:
        image = noise(ny, nx, kind)
        bands = bands_for(image)
        bands[:, :nx] = 77
        scan_every_row(image, bands)
        for band, line in enumerate(bands):
            starts = np.minimum(rows_of(band, np.arange(0, ny, 4)), ny - 4)
            expected = np.max([image[start : start + 4].min(axis=0) for start in starts], axis=0)
            assert np.array_equal(line[:nx], expected)
            assert not line[nx:].any()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("step", [2, 3, 8, 40])
@pytest.mark.parametrize("ny", HEIGHTS)
def test_some_rows(ny: int, step: int, kind: type[np.unsignedinteger]) -> None:
    for nx in WIDTHS:
        image = noise(ny, nx, kind)
        bands = bands_for(image)
        bands[:, :nx] = 77
        scan_some_rows(image, step, bands)
        for band, line in enumerate(bands):
            rows = rows_of(band, np.arange(step // 2, ny, step))
            expected = image[rows].max(axis=0) if len(rows) else np.zeros(nx, dtype=kind)
            assert np.array_equal(line[:nx], expected)
            assert not line[nx:].any()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("step", [1, 8])
def test_background_is_the_median_of_a_grid_in_rows_that_were_read(
    step: int, kind: type[np.unsignedinteger]
) -> None:
    image = noise(240, 320, kind)
    rows = (2 * np.arange(16) + 1) * 240 // 32
    rows -= (rows - step // 2) % step
    grid = np.sort(image[np.ix_(rows, (2 * np.arange(32) + 1) * 320 // 64)].ravel())
    middle, spread = background_of(image, step, np.zeros(SAMPLES, dtype=np.int64))
    assert middle == grid[256]
    assert spread == pytest.approx(max((int(grid[256]) - int(grid[102])) / 0.8416, 0.3))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("place", [(0, 0), (90, 10), (255, 31), (297, 92)])
def test_brightest_is_the_middle_of_the_brightest_plateau(
    place: tuple[int, int], kind: type[np.unsignedinteger]
) -> None:
    image = np.full((100, 300), 7, dtype=kind)
    x, y = place
    image[y : y + 8, x : x + 3] = 200
    image[50, 150] = 250
    bands = bands_for(image)
    scan_every_row(image, bands)
    peak, found_x, found_y = brightest(image, bands)
    assert (peak, found_x) == (200, x + 1)
    assert y <= found_y < y + 8
