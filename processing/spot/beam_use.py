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
from processing.spot.model_choice import LONGEST_CHOICE_FRAMES, SpotModel

_NEW_CHOICE_FRAMES = 64
"""Fewest frames in a row with another model that count as a new choice: fewer are frames without the chosen
one, since a choice takes longer."""

_FLAGS, _MODELS = tuple(SpotFlag), tuple(SpotModel)
_BITS = np.array(_FLAGS, dtype=np.int64)


class BeamUse:
    """Counts of the spots of a run by model and flag, added some frames at a time.

    Spots before the first learned profile fit poorly because it is not learned yet: they are counted with
    their flags, but not among the judged ones.

    Attributes
    ----------
    frames
        Number of frames so far.
    flags
        Number of spots with each flag.
    model, since_frame
        The model in use, and the number of the first frame fitted with it; None and -1 without a spot.
    changes
        Number of times the beam got another model after its first choice.
    choosing_frames
        Number of spots before a profile was learned for the first time; 0 if none was.
    judged_frames, poor_frames
        Number of spots since then, and of those among them with the flag POOR_FIT.
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
        self._found = 0
        self._learned = False
        self._other: SpotModel | None = None
        self._other_since = -1
        self._others = 0

    @property
    def text(self) -> str:
        """Model in use and its first frame, as in `learned profile since frame 147`, or `no spot`."""
        return "no spot" if self.model is None else f"{self.model} since frame {self.since_frame}"

    def take(self, sequences: ArrayLike, flags: ArrayLike) -> None:
        """Add the numbers and flags of the next frames, arrays of one length."""
        numbers, marks = np.asarray(sequences, dtype=np.int64), np.asarray(flags, dtype=np.int64)
        self.frames += len(marks)
        _count(self.flags, marks)
        found = (marks & SpotFlag.LOST) == 0
        numbers, marks = numbers[found], marks[found]
        models = np.where(marks & SpotFlag.LEARNED, 2, np.where(marks & SpotFlag.MULTIPLE, 1, 0))
        starts = np.flatnonzero(np.diff(models, prepend=-1))
        for start, count in zip(starts.tolist(), np.diff(starts, append=len(models)).tolist(), strict=True):
            self._stretch(_MODELS[models[start]], int(numbers[start]), marks[start : start + count])

    def _stretch(self, model: SpotModel, number: int, marks: Ints) -> None:
        """Add spots in a row that were fitted with the same model, from frame `number` on."""
        first_learned = model is SpotModel.LEARNED and not self._learned
        if first_learned:
            self._learned = True
            if self._found <= LONGEST_CHOICE_FRAMES:
                self.choosing_frames = self._found
                self.judged_frames = self.poor_frames = 0
                self.poor_with = dict.fromkeys(SpotFlag, 0)
        self._judge(marks)
        if self.model is None:
            self.model, self.since_frame = model, number
        elif model is self.model:
            self._others = 0
        else:
            if model is not self._other or not self._others:
                self._other, self._other_since, self._others = model, number, 0
            self._others += len(marks)
            if first_learned or self._others >= _NEW_CHOICE_FRAMES:
                self.model, self.since_frame, self._others = model, self._other_since, 0
                self.changes += self._found > LONGEST_CHOICE_FRAMES
        self._found += len(marks)

    def _judge(self, marks: Ints) -> None:
        self.judged_frames += len(marks)
        poor = marks[(marks & SpotFlag.POOR_FIT) != 0]
        self.poor_frames += len(poor)
        _count(self.poor_with, poor)


def _count(flags: dict[SpotFlag, int], marks: Ints) -> None:
    """Add the number of spots with each flag to `flags`."""
    if len(marks):
        found = np.count_nonzero(marks[:, None] & _BITS, axis=0)
        for flag, count in zip(_FLAGS, found.tolist(), strict=True):
            flags[flag] += count


_AWAY_SIGMAS = 4.5
"""Distance from the spot beyond which its own light is below 4e-5 of the peak."""
_MIN_PICTURES = 4
"""Fewest pictures with the spot away from a pixel, from which the other light of the pixel is known."""
_CHANCE_U = 5.0
"""Smallest shift, in standard uncertainties of the mean of the pictures, that is not by chance."""
_SHIFT_U = 1.0
"""Smallest shift, in standard uncertainties of a position, that matters."""
_REACH_SIGMAS = 5.5
"""Distance from the spot's centre within which light shifts its fit: the window and the light's width."""
_SINGLE_PIXEL_HEIGHT = 0.1
"""Height of a single pixel above its neighbours, in the spot's amplitude, from which it is a hot pixel, which
every fit of a spot leaves out as an outlier, and no light."""
_LIT_SIGMAS = 6.0
"""Standard deviations of the mean picture above which a pixel is lit."""


@dataclass(frozen=True, eq=False)
class FixedLight:
    """Light that does not move with the spot: a reflection, a lamp."""

    light_dn: Floats
    """(ny, nx) the light, above its median; 0 where the spot always was."""
    sigma_px: float
    """Standard deviation of the spot."""
    x_px: int
    y_px: int
    """Place of the brightest fixed light near the path of the spot."""
    relative_height: float
    """Light at that place, relative to the spot's amplitude."""
    shift_px: float
    """Largest shift of a position by the light."""
    shift_in_u: float
    """Largest shift, in standard uncertainties of a position."""

    @property
    def text(self) -> str:
        """Sentence part with the kind of the light, its place and its effect."""
        return (
            f"light that stays where it is, {100 * self.relative_height:.2g} % of the spot at x {self.x_px}, "
            f"y {self.y_px} px (a reflection, a lamp): shifts the spot by up to {self.shift_px:.2g} px, "
            f"{self.shift_in_u:.2g} times the uncertainty of a position"
        )

    @cached_property
    def lit(self) -> Flags:
        """Pixels (ny, nx) that are significantly lit."""
        from scipy.ndimage import gaussian_filter

        # a third of the spot's size, over which the light of optics varies little
        smooth = gaussian_filter(self.light_dn, self.sigma_px / 3.0)
        seen = smooth[self.light_dn != 0.0]
        return np.asarray(smooth > _LIT_SIGMAS * robust_scatter(seen))

    @cached_property
    def subtracted_dn(self) -> Floats:
        """Light (ny, nx) to subtract from pictures: at and around lit pixels, without the noise elsewhere."""
        from scipy.ndimage import binary_dilation

        return np.where(binary_dilation(self.lit, iterations=round(self.sigma_px) or 1), self.light_dn, 0.0)

    def affects(self, x_px: Floats, y_px: Floats) -> Flags:
        """Whether the fits of spots at these places (n,) include lit pixels."""
        from scipy.ndimage import distance_transform_edt

        near = distance_transform_edt(~self.lit) <= _REACH_SIGMAS * self.sigma_px
        ny, nx = near.shape
        at_x, at_y = (np.nan_to_num(np.rint(place)).astype(np.int64) for place in (x_px, y_px))
        return np.asarray(near[np.clip(at_y, 0, ny - 1), np.clip(at_x, 0, nx - 1)] & np.isfinite(x_px))


def fixed_light(pictures: Sequence[tuple[Image, Spot]]) -> FixedLight | None:
    """Light that does not move in pictures of a moving spot; None if its shifts do not matter."""
    pairs = [(image, spot) for image, spot in pictures if not spot.flags & SpotFlag.LOST]
    if len(pairs) < 2 * _MIN_PICTURES:
        return None
    found = [spot for _, spot in pairs]
    sigma = float(np.median([np.sqrt(spot.sigma_x_px * spot.sigma_y_px) for spot in found]))
    height = float(np.median([spot.amplitude_dn for spot in found]))
    u_px = float(np.median([spot.u_x_px for spot in found]))
    shape = pairs[0][0].shape
    total, count = np.zeros(shape), np.zeros(shape)
    for image, spot in pairs:
        box, by_spot = _box_around(shape, spot, _AWAY_SIGMAS * sigma)
        total += image
        total[box] -= np.where(by_spot, image[box], 0.0)
        count += 1.0
        count[box] -= by_spot
    known = count >= _MIN_PICTURES
    if not known.any():
        return None
    mean = total / np.maximum(count, 1.0)
    light = np.where(known, mean - np.median(mean[known]), 0.0)
    least_px = max(_SHIFT_U * u_px, _CHANCE_U * u_px / np.sqrt(float(np.median(count[known]))))
    if max(_shift(light, spot, sigma, height) for spot in found) < least_px:
        return None
    # imported here, because it would slow down fits of records without fixed light
    from scipy.ndimage import gaussian_filter, median_filter

    neighbours = median_filter(light, size=3)
    light = np.where(light - neighbours > _SINGLE_PIXEL_HEIGHT * height, neighbours, light)
    shift_px = max(_shift(light, spot, sigma, height) for spot in found)
    if shift_px < least_px:
        return None
    # smoothing by its own width leaves half the height of a spot
    smooth = 2.0 * gaussian_filter(light, sigma)
    near = np.zeros(shape, dtype=np.bool_)
    for spot in found:
        box, by_spot = _box_around(shape, spot, 4.0 * sigma)
        near[box] |= by_spot
    y, x = np.unravel_index(int(np.argmax(np.where(near, smooth, -np.inf))), shape)
    return FixedLight(light, sigma, int(x), int(y), float(smooth[y, x]) / height, shift_px, shift_px / u_px)


def _box_around(shape: tuple[int, ...], spot: Spot, reach_px: float) -> tuple[tuple[slice, slice], Flags]:
    """Box of a picture around all pixels within a distance of a spot, and which of its pixels these are."""
    rows, columns = (
        slice(max(math.floor(at - reach_px), 0), max(math.ceil(at + reach_px) + 1, 0))
        for at in (spot.y_px, spot.x_px)
    )
    y, x = np.ogrid[: shape[0], : shape[1]]
    return (rows, columns), np.hypot(x[:, columns] - spot.x_px, y[rows] - spot.y_px) <= reach_px


def _shift(light: Floats, spot: Spot, sigma: float, height: float) -> float:
    """Shift in px of a Gaussian's fit by other light: the projection of the light on the derivative."""
    reach = int(5 * sigma) + 1
    x, y = round(spot.x_px), round(spot.y_px)
    rows, columns = slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1)
    near = light[rows, columns]
    v, u = np.ogrid[rows.start : rows.start + near.shape[0], columns.start : columns.start + near.shape[1]]
    u, v = u - spot.x_px, v - spot.y_px
    weight = near * np.exp(-(u * u + v * v) / (2 * sigma**2)) * 2.0 / (np.pi * height * sigma**2)
    return float(np.hypot((weight * u).sum(), (weight * v).sum()))


_PICTURE_HALF_WIDTH = 5.0
"""Half-width of the picture in standard deviations of the spot."""
_MAX_PIXELS_PER_SIGMA = 8.0
"""Most pixels per standard deviation of the spot; pictures with twice as many or more are averaged."""
_SMOOTHING_SIGMA = 0.33
"""Standard deviation of the smoothing, in those of the spot; it removes single pixels and noise."""
_DIRECTIONS = 12

Picture = Floats


@dataclass(frozen=True, slots=True)
class BeamShape:
    """Numbers that describe the shape of a beam.

    Attributes
    ----------
    departure
        Largest smoothed difference from the fitted Gaussian, relative to its peak; 0 for a Gaussian.
    away_sigmas, away_px
        Distance of that difference from the centre.
    extra_light
        Whether the beam has more light there than the Gaussian.
    lopsided
        Ratio of the steepest fall of the light on one side to that on the opposite side, the largest of
        several directions; 1 for a Gaussian. An obstacle in the beam makes one side steep.
    """

    departure: float
    away_sigmas: float
    away_px: float
    extra_light: bool
    lopsided: float


def beam_shape(images: Sequence[Image], spots: Sequence[Spot], full_scale_dn: float) -> BeamShape | None:
    """Shape of the beam, averaged over whole frames (ny, nx); None if no spot was found in any.

    The spots may be at different places and fractions of a pixel: the Gaussian is subtracted in each frame.
    """
    seen = [
        (image, spot) for image, spot in zip(images, spots, strict=True) if not spot.flags & SpotFlag.LOST
    ]
    if not seen:
        return None
    sigma_px = float(np.median([math.sqrt(spot.sigma_x_px * spot.sigma_y_px) for _, spot in seen]))
    widest_px = float(np.median([max(spot.sigma_x_px, spot.sigma_y_px) for _, spot in seen]))
    half = math.ceil(_PICTURE_HALF_WIDTH * widest_px)
    light, rest, count = np.zeros((3, 2 * half + 1, 2 * half + 1))
    for image, spot in seen:
        _add(image, spot, full_scale_dn, light, rest, count)
    peak = float(np.median([spot.amplitude_dn for _, spot in seen]))
    coarse = max(1, int(sigma_px / _MAX_PIXELS_PER_SIGMA))
    light = _coarser(light / np.maximum(count, 1.0), coarse) / peak
    rest = _coarser(rest / np.maximum(count, 1.0), coarse) / peak
    smooth = _SMOOTHING_SIGMA * sigma_px / coarse
    left_over = _blurred(rest, smooth)
    row, column = np.unravel_index(int(np.argmax(np.abs(left_over))), left_over.shape)
    middle = 0.5 * (len(rest) - 1)
    away_px = coarse * math.hypot(float(row) - middle, float(column) - middle)
    return BeamShape(
        departure=abs(float(left_over[row, column])),
        away_sigmas=away_px / sigma_px,
        away_px=away_px,
        extra_light=bool(left_over[row, column] > 0),
        lopsided=_slope_asymmetry(light, smooth),
    )


def _add(
    image: Image, spot: Spot, full_scale_dn: float, light: Picture, rest: Picture, count: Picture
) -> None:
    """Add the pixels around a spot to the sums: light above the background, residuals, number of pixels."""
    half = len(light) // 2
    ny, nx = image.shape
    left, top = round(spot.x_px) - half, round(spot.y_px) - half
    y0, y1, x0, x1 = max(top, 0), min(top + len(light), ny), max(left, 0), min(left + len(light), nx)
    part = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
    u, v = np.arange(x0, x1) - spot.x_px, (np.arange(y0, y1) - spot.y_px)[:, None]
    c, s = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
    square = ((c * u + s * v) / spot.sigma_x_px) ** 2 + ((c * v - s * u) / spot.sigma_y_px) ** 2
    # integrated over the pixel to second order, as in the fit
    narrow = 1.0 / (1.0 + (spot.sigma_x_px**-2 + spot.sigma_y_px**-2) / 24.0)
    gaussian = spot.amplitude_dn * narrow * np.exp(-0.5 * narrow * square)
    over = image[y0:y1, x0:x1] - spot.background_dn
    light[part] += over
    rest[part] += over - np.minimum(gaussian, full_scale_dn - spot.background_dn)
    count[part] += 1.0


def _coarser(picture: Picture, by: int) -> Picture:
    """Means of `by` x `by` pixels around the middle."""
    if by == 1:
        return picture
    # an odd number of blocks, so that the middle stays in the middle of one
    blocks = len(picture) // by - (1 - len(picture) // by % 2)
    first = (len(picture) - blocks * by) // 2
    part = picture[first : first + blocks * by, first : first + blocks * by]
    return np.asarray(part.reshape(blocks, by, blocks, by).mean(axis=(1, 3)))


def _blur(size: int, sigma: float) -> Picture:
    """Matrix that convolves a row of `size` values with a Gaussian."""
    off = np.arange(size) - np.arange(size)[:, None]
    weights = np.exp(-0.5 * (off / sigma) ** 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _blurred(picture: Picture, sigma: float) -> Picture:
    blur = _blur(len(picture), sigma)
    return np.asarray(blur @ picture @ blur.T)


def _slope_asymmetry(light: Picture, smooth: float) -> float:
    """Largest ratio of rising to falling slope (or the inverse) of the light summed across a direction."""
    half = len(light) // 2
    v, u = np.indices(light.shape) - half
    blur = _blur(4 * half + 2, 0.5 * smooth)
    found = 1.0
    for angle in np.arange(_DIRECTIONS) * math.pi / _DIRECTIONS:
        along = (math.cos(angle) * u + math.sin(angle) * v).ravel() + 2 * half
        place = np.floor(along).astype(np.int64)
        part = along - place
        values = light.ravel()
        # each pixel is divided between two bins, so that no direction has full and empty ones
        total = np.bincount(place, values * (1.0 - part), 4 * half + 2)
        total[1:] += np.bincount(place, values * part, 4 * half + 2)[:-1]
        slopes = np.diff(blur @ total)[half : 3 * half + 1]
        rise, fall = float(slopes.max()), float(-slopes.min())
        if min(rise, fall) > 0:
            found = max(found, rise / fall, fall / rise)
    return found
