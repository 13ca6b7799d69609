"""Brightness, saturation and sharpness of a picture, for aligning laser and camera."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame, Image

_FLOOR = 0.1
# sqrt(A / B) for exp(-u) - 0.1 where it is positive, u = r^2 / (2 s^2), u0 = ln 10:
# A = (1 - exp(-2 u0) (1 + 2 u0)) / 2, B = 0.99 / 2 - 0.2 * 0.9 + 0.01 u0
_OF_A_CUT_GAUSSIAN = 1.1816


class PictureFigures(NamedTuple):
    """Figures of one picture.

    Attributes
    ----------
    peak
        Brightest value as a fraction of full scale, without single hot pixels (median of 3 x 3).
    saturated_px
        Pixels at full scale.
    background
        Median of the picture as a fraction of full scale.
    sharpness_per_px
        sqrt(sum |grad I|^2 / sum I^2), where I is the light above the background. For a round Gaussian
        spot of standard deviation s it is 1 / s, whatever the exposure. 0 for a picture without light.
    """

    peak: float
    saturated_px: int
    background: float
    sharpness_per_px: float


def figures(image: Image, full_scale_dn: int) -> PictureFigures:
    """Figures of a picture, shape (ny, nx), in DN."""
    calm = cv2.medianBlur(image, 3)
    background_dn = float(np.median(image))
    light = calm.astype(np.float64) - background_dn
    # subtract a tenth of the peak, to exclude the noise of the background
    light = np.maximum(light - _FLOOR * light.max(initial=0.0), 0.0)
    rows, columns = np.gradient(light)
    energy = float(np.sum(light * light))
    gradient = float(np.sum(rows * rows + columns * columns))
    return PictureFigures(
        float(calm.max()) / full_scale_dn,
        int(np.count_nonzero(image >= full_scale_dn)),
        background_dn / full_scale_dn,
        float(np.sqrt(gradient / energy)) / _OF_A_CUT_GAUSSIAN if energy > 0 else 0.0,
    )


def average(frames: Sequence[Frame]) -> Image:
    """Mean of frames, in their pixel type; reduces noise and speckle."""
    first = frames[0].image
    total = np.zeros(first.shape, np.float64)
    for frame in frames:
        total += frame.image
    mean = np.rint(total / len(frames))
    return mean.astype(np.uint8) if first.dtype == np.uint8 else mean.astype(np.uint16)


def histogram_bars(image: Image, full_scale_dn: int, bars: int = 16, width: int = 50) -> list[str]:
    """Lines of a histogram for a terminal; the length of a bar is logarithmic in the count."""
    counts: NDArray[np.int64] = np.histogram(image, bars, (0, full_scale_dn + 1))[0]
    longest = np.log1p(counts.max())
    lines = []
    for index, count in enumerate(counts):
        low = index * (full_scale_dn + 1) // bars
        bar = "#" * round(float(np.log1p(count) / longest) * width)
        lines.append(f"{low:>6} DN {bar:<{width}} {count}")
    return lines
