"""Model of the beam in a run, counts of the spots' flags, light that does not move, shape of the beam."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Flags, Floats, Ints
from processing.noise_models import robust_scatter
from processing.spot.fit_values import Image, Spot, SpotFlag
from processing.spot.model_choice import MAX_CHOICE_FRAMES, SpotModel

_NEW_CHOICE_FRAMES = 64
"""Fewest frames in a row with another model that count as a new choice. A choice takes longer: fewer frames
are those in which the chosen model could not be fitted."""
_MODELS = tuple(SpotModel)


class BeamUse:
    """Counts of the spots of a run by model and flag, added some frames at a time.

    Spots before the first learned profile fit poorly because it is not learned yet: they are counted with
    their flags, but not among the judged ones.

    Attributes
    ----------
    frames
        Number of frames.
    flags
        Number of spots with each flag.
    model, since_frame
        The model in use, and the number of the first frame fitted with it; None and -1 without a spot.
    changes
        Number of times the beam got another model after its first choice.
    choosing_frames
        Number of spots before a profile was learned for the first time; 0 if none was.
    judged_frames, poor_frames
        Number of spots since then, of all if no profile was learned; and of those among them with POOR_FIT.
    poor_with
        Number of spots with POOR_FIT that also have each other flag.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.flags = dict.fromkeys(SpotFlag, 0)
        self.model: SpotModel | None = None
        self.since_frame = -1
        self.changes = 0
        self.choosing_frames = 0
        self.judged_frames = 0
        self.poor_frames = 0
        self.poor_with = dict.fromkeys(SpotFlag, 0)
        self._spots = 0
        self._has_learned = False
        self._other_model: SpotModel | None = None
        self._other_since_frame = -1
        self._other_frames = 0

    @property
    def text(self) -> str:
        """Model in use and its first frame, as in `learned profile since frame 147`, or `no spot`."""
        return "no spot" if self.model is None else f"{self.model} since frame {self.since_frame}"

    def take(self, sequences: ArrayLike, flags: ArrayLike) -> None:
        """Add the numbers and flags of the next frames, arrays of one length."""
        numbers, marks = np.asarray(sequences, dtype=np.int64), np.asarray(flags, dtype=np.int64)
        self.frames += len(marks)
        _count(self.flags, marks)
        has_spot = (marks & SpotFlag.LOST) == 0
        numbers, marks = numbers[has_spot], marks[has_spot]
        models = np.where(marks & SpotFlag.LEARNED, 2, np.where(marks & SpotFlag.MULTIPLE, 1, 0))
        starts = np.flatnonzero(np.diff(models, prepend=-1))
        for start, count in zip(starts.tolist(), np.diff(starts, append=len(models)).tolist(), strict=True):
            self._add_run(_MODELS[models[start]], int(numbers[start]), marks[start : start + count])

    def _add_run(self, model: SpotModel, number: int, marks: Ints) -> None:
        """Add spots in a row that were fitted with the same model, from frame `number` on."""
        is_first_learned = model is SpotModel.LEARNED and not self._has_learned
        if is_first_learned:
            self._has_learned = True
            if self._spots <= MAX_CHOICE_FRAMES:
                self.choosing_frames = self._spots
                self.judged_frames = self.poor_frames = 0
                self.poor_with = dict.fromkeys(SpotFlag, 0)
        poor = marks[(marks & SpotFlag.POOR_FIT) != 0]
        self.judged_frames += len(marks)
        self.poor_frames += len(poor)
        _count(self.poor_with, poor)
        if self.model is None:
            self.model, self.since_frame = model, number
        elif model is self.model:
            self._other_frames = 0
        else:
            if model is not self._other_model or not self._other_frames:
                self._other_model, self._other_since_frame, self._other_frames = model, number, 0
            self._other_frames += len(marks)
            if is_first_learned or self._other_frames >= _NEW_CHOICE_FRAMES:
                self.model, self.since_frame, self._other_frames = model, self._other_since_frame, 0
                self.changes += self._spots > MAX_CHOICE_FRAMES
        self._spots += len(marks)


def _count(counts: dict[SpotFlag, int], marks: Ints) -> None:
    """Add the number of spots with each flag to `counts`."""
    for flag in SpotFlag:
        counts[flag] += int(np.count_nonzero(marks & flag.value))


_MIN_DISTANCE_SIGMA = 4.5
"""Distance from the spot beyond which its own light is below 4e-5 of the peak."""
_MIN_PICTURES = 4
"""Fewest pictures with the spot away from a pixel, from which the fixed light of the pixel is known."""
_MIN_SHIFT_U_OF_MEAN = 5.0
"""Smallest shift, in standard uncertainties of the mean of the pictures, that is not by chance."""
_MIN_SHIFT_U = 1.0
"""Smallest shift, in standard uncertainties of a position, that matters."""
_REACH_SIGMA = 5.5
"""Distance from the spot's centre within which light shifts its fit: the window and the light's width."""
_MIN_HOT_PIXEL_HEIGHT = 0.1
"""Height of a single pixel above its neighbours, in the spot's amplitude, above which it is a hot pixel. Fits
of spots leave it out as an outlier."""
_MIN_LIT_SIGMA = 6.0
"""Standard deviations of the mean picture above which a pixel is lit."""


@dataclass(frozen=True, eq=False)
class FixedLight:
    """Light that does not move with the spot: a reflection, a lamp."""

    light_dn: Floats
    """(ny, nx) light above its median; 0 for pixels from which the spot was seldom away."""
    sigma_px: float
    """Standard deviation of the spot."""
    x_px: int
    y_px: int
    """Position of the brightest fixed light near the path of the spot."""
    relative_height: float
    """Light at that position, relative to the spot's amplitude."""
    shift_px: float
    """Largest shift of a position by the light."""
    shift_in_u: float
    """Largest shift, in standard uncertainties of a position."""

    @property
    def text(self) -> str:
        """Part of a sentence with the kind of the light, its position and its effect."""
        return (
            f"light that stays where it is, {100 * self.relative_height:.2g} % of the spot at x {self.x_px}, "
            f"y {self.y_px} px (a reflection, a lamp): shifts the spot by up to {self.shift_px:.2g} px, "
            f"{self.shift_in_u:.2g} times the uncertainty of a position"
        )

    @cached_property
    def lit(self) -> Flags:
        """Pixels (ny, nx) that are significantly lit."""
        from scipy.ndimage import gaussian_filter

        # reflections vary little over a third of the spot's size
        smooth = gaussian_filter(self.light_dn, self.sigma_px / 3.0)
        return np.asarray(smooth > _MIN_LIT_SIGMA * robust_scatter(smooth[self.light_dn != 0.0]))

    @cached_property
    def subtracted_dn(self) -> Floats:
        """Light (ny, nx) to subtract from pictures: at and around lit pixels, without the noise elsewhere."""
        from scipy.ndimage import binary_dilation

        return np.where(binary_dilation(self.lit, iterations=round(self.sigma_px) or 1), self.light_dn, 0.0)

    def affects(self, x_px: Floats, y_px: Floats) -> Flags:
        """Whether the fits of spots at these positions (n,) include lit pixels."""
        from scipy.ndimage import distance_transform_edt

        near = distance_transform_edt(~self.lit) <= _REACH_SIGMA * self.sigma_px
        column, row = (
            np.clip(np.nan_to_num(np.rint(position)).astype(np.int64), 0, size - 1)
            for position, size in ((x_px, near.shape[1]), (y_px, near.shape[0]))
        )
        return np.asarray(near[row, column] & np.isfinite(x_px))


def fixed_light(pictures: Sequence[tuple[Image, Spot]]) -> FixedLight | None:
    """Light that does not move in pictures of a moving spot; None if its shifts do not matter."""
    pairs = [(image, spot) for image, spot in pictures if not spot.flags & SpotFlag.LOST]
    if len(pairs) < 2 * _MIN_PICTURES:
        return None
    spots = [spot for _, spot in pairs]
    sigma = float(np.median([np.sqrt(spot.sigma_x_px * spot.sigma_y_px) for spot in spots]))
    height = float(np.median([spot.amplitude_dn for spot in spots]))
    u_px = float(np.median([spot.u_x_px for spot in spots]))
    shape = pairs[0][0].shape
    total, count = np.zeros(shape), np.zeros(shape)
    for image, spot in pairs:
        box, is_near_spot = _box_around(shape, spot, _MIN_DISTANCE_SIGMA * sigma)
        total += image
        total[box] -= np.where(is_near_spot, image[box], 0.0)
        count += 1.0
        count[box] -= is_near_spot
    is_known = count >= _MIN_PICTURES
    if not is_known.any():
        return None
    mean = total / np.maximum(count, 1.0)
    light = np.where(is_known, mean - np.median(mean[is_known]), 0.0)
    u_mean_px = u_px / np.sqrt(float(np.median(count[is_known])))
    min_shift_px = max(_MIN_SHIFT_U * u_px, _MIN_SHIFT_U_OF_MEAN * u_mean_px)
    if max(_shift(light, spot, sigma, height) for spot in spots) < min_shift_px:
        return None
    # imported here, because it would slow down fits of records without fixed light
    from scipy.ndimage import gaussian_filter, median_filter

    neighbours = median_filter(light, size=3)
    light = np.where(light - neighbours > _MIN_HOT_PIXEL_HEIGHT * height, neighbours, light)
    shift_px = max(_shift(light, spot, sigma, height) for spot in spots)
    if shift_px < min_shift_px:
        return None
    # smoothing by its own width leaves half the height of a spot
    smooth = 2.0 * gaussian_filter(light, sigma)
    near = np.zeros(shape, dtype=np.bool_)
    for spot in spots:
        box, is_near_spot = _box_around(shape, spot, 4.0 * sigma)
        near[box] |= is_near_spot
    y, x = np.unravel_index(int(np.argmax(np.where(near, smooth, -np.inf))), shape)
    return FixedLight(light, sigma, int(x), int(y), float(smooth[y, x]) / height, shift_px, shift_px / u_px)


def _box_around(shape: tuple[int, ...], spot: Spot, reach_px: float) -> tuple[tuple[slice, slice], Flags]:
    """Box of a picture around all pixels within a distance of a spot, and which of its pixels these are."""
    rows, columns = (
        slice(max(math.floor(centre - reach_px), 0), max(math.ceil(centre + reach_px) + 1, 0))
        for centre in (spot.y_px, spot.x_px)
    )
    y, x = np.ogrid[: shape[0], : shape[1]]
    return (rows, columns), np.hypot(x[:, columns] - spot.x_px, y[rows] - spot.y_px) <= reach_px


def _shift(light: Floats, spot: Spot, sigma: float, height: float) -> float:
    """Shift in px of a Gaussian's fit by other light: the projection of that light on the derivative."""
    reach = int(5 * sigma) + 1
    x, y = round(spot.x_px), round(spot.y_px)
    rows, columns = slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1)
    near = light[rows, columns]
    v, u = np.ogrid[rows.start : rows.start + near.shape[0], columns.start : columns.start + near.shape[1]]
    u, v = u - spot.x_px, v - spot.y_px
    weight = near * np.exp(-(u * u + v * v) / (2 * sigma**2)) * 2.0 / (np.pi * height * sigma**2)
    return float(np.hypot((weight * u).sum(), (weight * v).sum()))


_PICTURE_HALF_WIDTH_SIGMA = 5.0
"""Half-width of the picture in standard deviations of the spot."""
_MAX_PIXELS_PER_SIGMA = 8.0
"""Most pixels per standard deviation of the spot; pictures with twice as many or more are averaged."""
_SMOOTHING_SIGMA = 0.33
"""Standard deviation of the smoothing, in those of the spot; it removes single pixels and noise."""
_DIRECTIONS = 12
"""Number of directions in which the slopes of the light are compared."""


@dataclass(frozen=True, slots=True)
class BeamShape:
    """Numbers that describe the shape of a beam."""

    departure: float
    """Largest smoothed difference from the fitted Gaussian, relative to its peak; 0 for a Gaussian."""
    away_sigmas: float
    away_px: float
    """Distance of that difference from the centre."""
    extra_light: bool
    """Whether the beam has more light there than the Gaussian."""
    lopsided: float
    """Ratio of the steepest fall of the light on one side to that on the opposite side, the largest of
    several directions; 1 for a Gaussian. An obstacle in the beam makes one side steep."""


def beam_shape(images: Sequence[Image], spots: Sequence[Spot], full_scale_dn: float) -> BeamShape | None:
    """Shape of the beam, averaged over whole frames (ny, nx); None if no spot was found in any.

    The spots may be at different places and fractions of a pixel: the Gaussian is subtracted in each frame.
    """
    pairs = [
        (image, spot) for image, spot in zip(images, spots, strict=True) if not spot.flags & SpotFlag.LOST
    ]
    if not pairs:
        return None
    sigma_px = float(np.median([math.sqrt(spot.sigma_x_px * spot.sigma_y_px) for _, spot in pairs]))
    wide_sigma_px = float(np.median([max(spot.sigma_x_px, spot.sigma_y_px) for _, spot in pairs]))
    half = math.ceil(_PICTURE_HALF_WIDTH_SIGMA * wide_sigma_px)
    light, residual, count = np.zeros((3, 2 * half + 1, 2 * half + 1))
    for image, spot in pairs:
        _add(image, spot, full_scale_dn, light, residual, count)
    peak = float(np.median([spot.amplitude_dn for _, spot in pairs]))
    block_px = max(1, int(sigma_px / _MAX_PIXELS_PER_SIGMA))
    light = _block_means(light / np.maximum(count, 1.0), block_px) / peak
    residual = _block_means(residual / np.maximum(count, 1.0), block_px) / peak
    smoothing_sigma = _SMOOTHING_SIGMA * sigma_px / block_px
    blur = _blur_matrix(len(residual), smoothing_sigma)
    departure = blur @ residual @ blur.T
    row, column = np.unravel_index(int(np.argmax(np.abs(departure))), departure.shape)
    middle = 0.5 * (len(residual) - 1)
    away_px = block_px * math.hypot(float(row) - middle, float(column) - middle)
    return BeamShape(
        departure=abs(float(departure[row, column])),
        away_sigmas=away_px / sigma_px,
        away_px=away_px,
        extra_light=bool(departure[row, column] > 0),
        lopsided=_slope_asymmetry(light, smoothing_sigma),
    )


def _add(
    image: Image, spot: Spot, full_scale_dn: float, light: Floats, residual: Floats, count: Floats
) -> None:
    """Add the pixels around a spot to the sums: light above the background, residuals, number of pixels."""
    half = len(light) // 2
    ny, nx = image.shape
    left, top = round(spot.x_px) - half, round(spot.y_px) - half
    y0, y1, x0, x1 = max(top, 0), min(top + len(light), ny), max(left, 0), min(left + len(light), nx)
    window = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
    u, v = np.arange(x0, x1) - spot.x_px, (np.arange(y0, y1) - spot.y_px)[:, None]
    c, s = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
    mahalanobis2 = ((c * u + s * v) / spot.sigma_x_px) ** 2 + ((c * v - s * u) / spot.sigma_y_px) ** 2
    # integrated over the pixel to second order, as in the fit
    scale = 1.0 / (1.0 + (spot.sigma_x_px**-2 + spot.sigma_y_px**-2) / 24.0)
    gaussian = spot.amplitude_dn * scale * np.exp(-0.5 * scale * mahalanobis2)
    spot_light = image[y0:y1, x0:x1] - spot.background_dn
    light[window] += spot_light
    residual[window] += spot_light - np.minimum(gaussian, full_scale_dn - spot.background_dn)
    count[window] += 1.0


def _block_means(picture: Floats, size: int) -> Floats:
    """Means of blocks of `size` x `size` pixels around the middle."""
    if size == 1:
        return picture
    # an odd number of blocks, so that the middle stays in the middle of a block
    blocks = len(picture) // size - (1 - len(picture) // size % 2)
    first = (len(picture) - blocks * size) // 2
    square = picture[first : first + blocks * size, first : first + blocks * size]
    return np.asarray(square.reshape(blocks, size, blocks, size).mean(axis=(1, 3)))


def _blur_matrix(size: int, sigma: float) -> Floats:
    """Matrix that convolves a row of `size` values with a Gaussian."""
    distance = np.arange(size) - np.arange(size)[:, None]
    weights = np.exp(-0.5 * (distance / sigma) ** 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _slope_asymmetry(light: Floats, smoothing_sigma: float) -> float:
    """Largest ratio of rising to falling slope (or the inverse) of the light summed across a direction."""
    half = len(light) // 2
    v, u = np.indices(light.shape) - half
    blur = _blur_matrix(4 * half + 2, 0.5 * smoothing_sigma)
    values = light.ravel()
    asymmetry = 1.0
    for angle in np.arange(_DIRECTIONS) * math.pi / _DIRECTIONS:
        distance = (math.cos(angle) * u + math.sin(angle) * v).ravel() + 2 * half
        bins = np.floor(distance).astype(np.int64)
        fraction = distance - bins
        # each pixel is divided between two bins, so that no direction has full and empty ones
        total = np.bincount(bins, values * (1.0 - fraction), 4 * half + 2)
        total[1:] += np.bincount(bins, values * fraction, 4 * half + 2)[:-1]
        slopes = np.diff(blur @ total)[half : 3 * half + 1]
        rise, fall = float(slopes.max()), float(-slopes.min())
        if min(rise, fall) > 0:
            asymmetry = max(asymmetry, rise / fall, fall / rise)
    return asymmetry
