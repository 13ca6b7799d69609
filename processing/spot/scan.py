"""Search of a whole frame for its brightest area, insensitive to hot pixels and limited by memory bandwidth.

The frame is divided into bands of BAND_ROWS rows. A scan reduces every band to one row that holds, for each
column, the highest value of the band. The brightest pixel is then searched for in these few rows.
"""

from collections.abc import Callable
from typing import Any, cast

from processing.arrays import Ints
from processing.kernel import intrinsic, kernel
from processing.spot.fit_values import Image

_CACHE_LINE_BYTES = 64
_READ, _KEEP, _DATA = 0, 3, 1
"""Arguments of LLVM's prefetch: reading, the longest stay in the cache, and the cache of data."""


@intrinsic
def _prefetch(typing_context: Any, image: Any, index: Any) -> Any:
    """Generate the LLVM prefetch instruction for `prefetch`."""
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba import types

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), ir.IntType(8).as_pointer())
        int32 = ir.IntType(32)
        signature_type = ir.FunctionType(ir.VoidType(), [address.type, int32, int32, int32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [address.type], signature_type)
        builder.call(function, [address, int32(_READ), int32(_KEEP), int32(_DATA)])
        return context.get_dummy_value()

    return types.void(image, types.intp), generate


prefetch = cast(Callable[[Image, int], None], _prefetch)
"""Start loading the cache line of an image element; the index counts elements in C order.

It can be called from compiled code only. It is a hint to the processor and has no effect on the result, also
for an index beyond the end of the image.
"""


@kernel
def prefetch_window(image: Image, x0: int, y0: int, nx: int, ny: int) -> None:
    """Start loading nx x ny pixels from (x0, y0) on.

    The processor's own prefetching does not recognise the rows of a window, which are far apart in memory.
    """
    width = image.shape[1]
    line_pixels = _CACHE_LINE_BYTES // image.itemsize
    for y in range(y0, y0 + ny):
        first = y * width + x0
        for index in range(first, first + nx, line_pixels):
            prefetch(image, index)
        prefetch(image, first + nx - 1)


BAND_ROWS = 32
BAND_STEP = 256
"""A band is padded to a multiple of this width, plus two pixels, so that vector loops have no remainder."""
_SAMPLES_X, _SAMPLES_Y = 32, 16
SAMPLES = _SAMPLES_X * _SAMPLES_Y
"""Number of pixels from which the background is estimated."""
_PARALLEL_BANDS = 4
"""Number of bands that are read in turn, so that more loads are under way at once."""
_VECTOR_PIXELS = 64
"""Pixels of which the length of a block is a multiple, so that vector loops have no remainder."""
_MAX_BLOCK_BYTES = 256
"""Largest number of bytes of a row between two prefetches: small enough that loads do not queue in bursts,
large enough that the overhead of a loop is negligible."""
_ROWS_AHEAD = 4
"""Number of scanned rows from the one that is read to the one that is prefetched."""

# The loops over a row use conditional expressions on values of the pixels' own type: min(), max() or a sum
# would be widened to 64 bits, and the compiler would not vectorise them.


@kernel
def scan_every_row(image: Image, bands: Image) -> None:
    """For each band and column, find the highest of the minima of four pixels one above the other.

    The minimum rejects hot pixels, whose neighbours are dark, and keeps a spot, which covers at least four
    rows. The image has at least five, as `SearchMemory` demands. The results are written into `bands`.
    """
    ny, nx = image.shape
    pixels = image.reshape(ny * nx)
    line_pixels = _CACHE_LINE_BYTES // image.itemsize
    vectors = min(nx, _MAX_BLOCK_BYTES // image.itemsize) // _VECTOR_PIXELS
    block = vectors * _VECTOR_PIXELS if vectors > 0 else nx
    n_bands = (ny + BAND_ROWS - 1) // BAND_ROWS
    interval = (n_bands + _PARALLEL_BANDS - 1) // _PARALLEL_BANDS
    bands[:, :nx] = 0
    for start in range(interval):
        for y in range(0, BAND_ROWS, 4):
            for x in range(0, nx, block):
                # the last block overlaps the one before, which does not change the maxima
                column = min(x, nx - block)
                for band in range(start, n_bands, interval):
                    row = band * BAND_ROWS + y
                    if row >= ny:
                        continue
                    # if the number of rows is no multiple of four, the last group overlaps the one before
                    top = min(row, ny - 4)
                    # the processor itself does not recognise four rows read in parallel as a stream
                    ahead = (top + 4) * nx + 4 * x
                    for index in range(ahead, ahead + 4 * block, line_pixels):
                        prefetch(image, index)
                    first = top * nx + column
                    row0 = pixels[first : first + block]
                    row1 = pixels[first + nx : first + nx + block]
                    row2 = pixels[first + 2 * nx : first + 2 * nx + block]
                    row3 = pixels[first + 3 * nx : first + 3 * nx + block]
                    maxima = bands[band, column : column + block]
                    for i in range(block):
                        upper = row0[i] if row0[i] < row1[i] else row1[i]
                        lower = row2[i] if row2[i] < row3[i] else row3[i]
                        value = upper if upper < lower else lower
                        maxima[i] = value if value > maxima[i] else maxima[i]


@kernel
def scan_some_rows(image: Image, row_step: int, bands: Image) -> None:
    """For each band and column, write the highest pixel among every `row_step`-th row into `bands`."""
    ny, nx = image.shape
    line_pixels = _CACHE_LINE_BYTES // image.itemsize
    for band in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        line = bands[band]
        line[:nx] = 0
        first = band * BAND_ROWS
        for y in range(first + (row_step // 2 - first) % row_step, min(ny, first + BAND_ROWS), row_step):
            ahead = (y + _ROWS_AHEAD * row_step) * nx
            for index in range(ahead, ahead + nx, line_pixels):
                prefetch(image, index)
            row = image[y]
            for i in range(nx):
                value = row[i]
                line[i] = value if value > line[i] else line[i]


@kernel
def _highest_of_three(line: Image, first: int, count: int) -> int:
    """Highest of the minima of three neighbouring pixels, for `count` triples from `first` on."""
    left = line[first : first + count]
    middle = line[first + 1 : first + 1 + count]
    right = line[first + 2 : first + 2 + count]
    top = left[0]
    top = top if top < middle[0] else middle[0]
    top = top if top < right[0] else right[0]
    for i in range(count):
        value = left[i] if left[i] < middle[i] else middle[i]
        value = value if value < right[i] else right[i]
        top = value if value > top else top
    return int(top)


@kernel
def lowest_of_three(image: Image, x: int, y: int) -> int:
    """Lowest of a pixel and its neighbours to the left and right: a hot pixel does not raise it."""
    return int(min(min(image[y, x - 1], image[y, x]), image[y, x + 1]))


@kernel
def brightest(image: Image, bands: Image) -> tuple[int, int, int]:
    """Brightest pixel after a scan: value of `lowest_of_three` there in DN, and x, y in px."""
    ny, nx = image.shape
    width = bands.shape[1] - 2
    band = 0
    best = -1
    for k in range((ny + BAND_ROWS - 1) // BAND_ROWS):
        top = _highest_of_three(bands[k], 0, width)
        if top > best:
            best = top
            band = k
    line = bands[band]
    first_x = 0
    while _highest_of_three(line, first_x, BAND_STEP) < best:
        first_x += BAND_STEP
    while min(min(line[first_x], line[first_x + 1]), line[first_x + 2]) < best:
        first_x += 1
    # take the middle of a plateau, as a saturated spot has one
    stop = first_x
    while stop < nx - 2 and min(min(line[stop], line[stop + 1]), line[stop + 2]) == best:
        stop += 1
    x = min((first_x + stop) // 2 + 1, nx - 2)
    prefetch_window(image, x - 1, max(0, band * BAND_ROWS - 1), 3, BAND_ROWS + 2)
    peak = -1
    first = last = band * BAND_ROWS
    # Along y also take the middle of a plateau. The search takes one row more on either side, in case the
    # border of two bands cuts through the spot.
    for y in range(max(0, band * BAND_ROWS - 1), min(ny, (band + 1) * BAND_ROWS + 1)):
        value = lowest_of_three(image, x, y)
        if value > peak:
            peak = value
            first = last = y
        elif value == peak and y == last + 1:
            last = y
    return peak, x, (first + last) // 2


@kernel
def _order_statistic(sample: Ints, rank: int, bits: int) -> int:
    """Highest value of `bits` bits such that at most `rank` of the sample are lower, found bit by bit."""
    value = 0
    for bit in range(bits - 1, -1, -1):
        trial = value | (1 << bit)
        lower = 0
        for k in range(sample.size):
            lower += 1 if sample[k] < trial else 0
        if lower <= rank:
            value = trial
    return value


@kernel
def background_of(image: Image, row_step: int, sample: Ints) -> tuple[float, float]:
    """Median and robust standard deviation, DN, of a grid of 512 pixels in rows that the scan has read."""
    ny, nx = image.shape
    count = 0
    for j in range(_SAMPLES_Y):
        y = (2 * j + 1) * ny // (2 * _SAMPLES_Y)
        y = max(0, y - (y - row_step // 2) % row_step)
        for i in range(_SAMPLES_X):
            sample[count] = image[y, (2 * i + 1) * nx // (2 * _SAMPLES_X)]
            count += 1
    bits = 8 * image.itemsize
    median = _order_statistic(sample, count // 2, bits)
    # The 20 % quantile of a normal distribution lies 0.8416 standard deviations below its mean. The lower
    # half is used because light, from the spot or a reflection, only raises pixels.
    quantile = _order_statistic(sample, count // 5, bits)
    return float(median), max((median - quantile) / 0.8416, 0.3)


@kernel
def brightest_block(image: Image, size: int, clip: float) -> tuple[float, int, int]:
    """Highest mean of a block of size x size pixels: mean in DN, and x, y of its centre.

    Pixels are clipped at `clip`, so that a hot pixel contributes little.
    """
    ny, nx = image.shape
    best, best_x, best_y = -1.0, nx // 2, ny // 2
    for y in range(0, ny - size + 1, size):
        for x in range(0, nx - size + 1, size):
            total = 0.0
            for j in range(size):
                for i in range(size):
                    total += min(float(image[y + j, x + i]), clip)
            if total > best:
                best = total
                best_x = x + size // 2
                best_y = y + size // 2
    return best / (size * size), best_x, best_y
