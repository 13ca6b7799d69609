"""Which model of the beam a run used, how many spots have which flag, and light that stays where it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Flags, Floats, Ints
from processing.spot.fit_values import Image, Spot, SpotFlag
from processing.spot.model_choice import LONGEST_CHOICE_FRAMES, SpotModel

_ANOTHER_FRAMES = 64
"""Fewer frames in a row with another model are frames that the chosen one missed: a choice takes longer."""

_FLAGS, _MODELS = tuple(SpotFlag), tuple(SpotModel)
_BITS = np.array(_FLAGS, dtype=np.int64)


class BeamUse:
    """Counts the spots of a run as they pass, some frames at a time.

    The spots before the first choice of a learned profile fit badly because it is not there yet: they are
    counted with their flags, but not judged.

    Attributes
    ----------
    frames
        How many have passed.
    flags
        Number of spots with each flag.
    model, since_frame
        The model in use, and the number of the first frame fitted with it; None and -1 without a spot.
    changes
        How many times the beam got another model after its first choice.
    choosing_frames
        Spots before a profile was learned for the first time; 0 if none was.
    judged_frames, poor_frames
        Spots since then, and how many of them have the flag POOR_FIT.
    poor_with
        How many of the latter also have each other flag.
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
        """`learned profile since frame 147`, or that there is no spot."""
        return "no spot" if self.model is None else f"{self.model} since frame {self.since_frame}"

    def take(self, sequences: ArrayLike, flags: ArrayLike) -> None:
        """Numbers and flags of the next frames, arrays of one length."""
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
        """Some spots in a row that were fitted with the same model."""
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
            if first_learned or self._others >= _ANOTHER_FRAMES:
                self.model, self.since_frame, self._others = model, self._other_since, 0
                self.changes += self._found > LONGEST_CHOICE_FRAMES
        self._found += len(marks)

    def _judge(self, marks: Ints) -> None:
        self.judged_frames += len(marks)
        poor = marks[(marks & SpotFlag.POOR_FIT) != 0]
        self.poor_frames += len(poor)
        _count(self.poor_with, poor)


def _count(flags: dict[SpotFlag, int], marks: Ints) -> None:
    """Add how many of the spots have each flag."""
    if len(marks):
        found = np.count_nonzero(marks[:, None] & _BITS, axis=0)
        for flag, count in zip(_FLAGS, found.tolist(), strict=True):
            flags[flag] += count


_AWAY_SIGMAS = 4.5
"""From the spot: of its own light 4e-5 is left there."""
_FEWEST = 4
"""Pictures, without the spot near a pixel, from which on it is known what is there otherwise."""
_CLEAR = 5.0
"""Shift, in standard uncertainties that the pictures leave, from which on it is none by chance."""
_WORTH = 1.0
"""Shift, in standard uncertainties of a position, from which on it matters."""
_REACH_SIGMAS = 5.5
"""From the spot's middle, within which light pulls its fit: its window, and half a pixel of its own."""
_LIT = 6.0
"""Standard deviations of the mean picture, from which on a pixel is lit."""
_MAD = 1.4826


@dataclass(frozen=True, eq=False)
class FixedLight:
    """`light_dn` (ny, nx) is what stays, above its median; 0 where the spot always was.

    The brightest of it near the spot's way is at (`x_px`, `y_px`), `part` of the spot's own height.
    `shift_px` is the largest shift of the spot that follows, `in_u` the same in uncertainties of a position.
    `sigma_px` is that of the spot.
    """

    light_dn: Floats
    sigma_px: float
    x_px: int
    y_px: int
    part: float
    shift_px: float
    in_u: float

    @property
    def text(self) -> str:
        """What it is, where, and what it does."""
        return (
            f"light that stays where it is, {100 * self.part:.2g} % of the spot at x {self.x_px}, "
            f"y {self.y_px} px (a reflection, a lamp): shifts the spot by up to {self.shift_px:.2g} px, "
            f"{self.in_u:.2g} times the uncertainty of a position"
        )

    @cached_property
    def lit(self) -> Flags:
        """Pixels (ny, nx) that it lights beyond doubt."""
        from scipy.ndimage import gaussian_filter

        # a third of the spot's size, over which nothing of it varies much
        smooth = gaussian_filter(self.light_dn, self.sigma_px / 3.0)
        seen = smooth[self.light_dn != 0.0]
        return np.asarray(smooth > _LIT * _MAD * float(np.median(np.abs(seen - np.median(seen)))))

    @cached_property
    def taken_off_dn(self) -> Floats:
        """What is taken off pictures (ny, nx): light where it is lit and around it, no noise elsewhere."""
        from scipy.ndimage import binary_dilation

        return np.where(binary_dilation(self.lit, iterations=round(self.sigma_px) or 1), self.light_dn, 0.0)

    def pulls(self, x_px: Floats, y_px: Floats) -> Flags:
        """Whether spots at these places (n,) have some of it among the pixels that are fitted."""
        from scipy.ndimage import distance_transform_edt

        near = distance_transform_edt(~self.lit) <= _REACH_SIGMAS * self.sigma_px
        ny, nx = near.shape
        at_x, at_y = (np.nan_to_num(np.rint(place)).astype(np.int64) for place in (x_px, y_px))
        return np.asarray(near[np.clip(at_y, 0, ny - 1), np.clip(at_x, 0, nx - 1)] & np.isfinite(x_px))


def fixed_light(pictures: Sequence[tuple[Image, Spot]]) -> FixedLight | None:
    """What stays in pictures of a spot that moves; None where nothing does, or nothing that matters."""
    pairs = [(image, spot) for image, spot in pictures if not spot.flags & SpotFlag.LOST]
    if len(pairs) < 2 * _FEWEST:
        return None
    found = [spot for _, spot in pairs]
    sigma = float(np.median([np.sqrt(spot.sigma_x_px * spot.sigma_y_px) for spot in found]))
    height = float(np.median([spot.amplitude_dn for spot in found]))
    u_px = float(np.median([spot.u_x_px for spot in found]))
    shape = pairs[0][0].shape
    total, count = np.zeros(shape), np.zeros(shape)
    for image, spot in pairs:
        box, by_spot = _around(shape, spot, _AWAY_SIGMAS * sigma)
        total += image
        total[box] -= np.where(by_spot, image[box], 0.0)
        count += 1.0
        count[box] -= by_spot
    known = count >= _FEWEST
    if not known.any():
        return None
    mean = total / np.maximum(count, 1.0)
    light = np.where(known, mean - np.median(mean[known]), 0.0)
    shifts = np.array([_shift(light, spot, sigma, height) for spot in found])
    shift_px = float(np.abs(shifts).max())
    if shift_px < max(_WORTH * u_px, _CLEAR * u_px / np.sqrt(float(np.median(count[known])))):
        return None
    # here, because it would slow down fits of records without any
    from scipy.ndimage import gaussian_filter

    # of light as wide as the spot half the height is left
    smooth = 2.0 * gaussian_filter(light, sigma)
    near = np.zeros(shape, dtype=np.bool_)
    for spot in found:
        box, by_spot = _around(shape, spot, 4.0 * sigma)
        near[box] |= by_spot
    y, x = np.unravel_index(int(np.argmax(np.where(near, smooth, -np.inf))), shape)
    return FixedLight(light, sigma, int(x), int(y), float(smooth[y, x]) / height, shift_px, shift_px / u_px)


def _around(shape: tuple[int, ...], spot: Spot, reach_px: float) -> tuple[tuple[slice, slice], Flags]:
    """The part of a picture that has all pixels within a distance of a spot, and which of it are."""
    rows, columns = (
        slice(max(math.floor(at - reach_px), 0), max(math.ceil(at + reach_px) + 1, 0))
        for at in (spot.y_px, spot.x_px)
    )
    y, x = np.ogrid[: shape[0], : shape[1]]
    return (rows, columns), np.hypot(x[:, columns] - spot.x_px, y[rows] - spot.y_px) <= reach_px


def _shift(light: Floats, spot: Spot, sigma: float, height: float) -> float:
    """By how much, in px, light beside a Gaussian pulls its fit: the part of it along the derivative."""
    reach = int(5 * sigma) + 1
    x, y = round(spot.x_px), round(spot.y_px)
    rows, columns = slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1)
    near = light[rows, columns]
    v, u = np.ogrid[rows.start : rows.start + near.shape[0], columns.start : columns.start + near.shape[1]]
    u, v = u - spot.x_px, v - spot.y_px
    weight = near * np.exp(-(u * u + v * v) / (2 * sigma**2)) * 2.0 / (np.pi * height * sigma**2)
    return float(np.hypot((weight * u).sum(), (weight * v).sum()))


_REACH = 5.0
"""Half-width of the picture in standard deviations of the spot."""
_FINEST = 8.0
"""Pixels in a standard deviation; where there are twice as many, they are averaged."""
_SMOOTH = 0.33
"""Standard deviation of the smoothing, in those of the spot: single pixels and noise are no shape."""
_DIRECTIONS = 12

Picture = Floats


@dataclass(frozen=True, slots=True)
class BeamShape:
    """Numbers of a beam's shape; the comments give those of a Gaussian.

    Attributes
    ----------
    departure
        Largest difference from the Gaussian that was fitted, smoothed, over its peak: 0.
    away_sigmas, away_px
        Distance of that place from the centre.
    extra_light
        Whether there is more light than the Gaussian has, not less.
    middle
        Light at the centre over that of the brightest ring around it: 1. Hollow beams have less.
    lopsided
        Steepest fall of the light on one side over that on the opposite side, the largest of several
        directions: 1. What cuts a beam makes one side steep.
    """

    departure: float
    away_sigmas: float
    away_px: float
    extra_light: bool
    middle: float
    lopsided: float


def beam_shape(images: Sequence[Image], spots: Sequence[Spot], full_scale_dn: float) -> BeamShape | None:
    """The shape of the beam in some whole frames (ny, nx), averaged; None where no spot was found in any.

    Frames may differ in place and in fractions of a pixel: the Gaussian is subtracted in each of them.
    """
    seen = [
        (image, spot) for image, spot in zip(images, spots, strict=True) if not spot.flags & SpotFlag.LOST
    ]
    if not seen:
        return None
    sigma_px = float(np.median([math.sqrt(spot.sigma_x_px * spot.sigma_y_px) for _, spot in seen]))
    widest_px = float(np.median([max(spot.sigma_x_px, spot.sigma_y_px) for _, spot in seen]))
    half = math.ceil(_REACH * widest_px)
    light, rest, count = np.zeros((3, 2 * half + 1, 2 * half + 1))
    for image, spot in seen:
        _add(image, spot, full_scale_dn, light, rest, count)
    peak = float(np.median([spot.amplitude_dn for _, spot in seen]))
    coarse = max(1, int(sigma_px / _FINEST))
    light = _coarser(light / np.maximum(count, 1.0), coarse) / peak
    rest = _coarser(rest / np.maximum(count, 1.0), coarse) / peak
    smooth = _SMOOTH * sigma_px / coarse
    left_over = _blurred(rest, smooth)
    row, column = np.unravel_index(int(np.argmax(np.abs(left_over))), left_over.shape)
    middle = 0.5 * (len(rest) - 1)
    away_px = coarse * math.hypot(float(row) - middle, float(column) - middle)
    return BeamShape(
        departure=abs(float(left_over[row, column])),
        away_sigmas=away_px / sigma_px,
        away_px=away_px,
        extra_light=bool(left_over[row, column] > 0),
        middle=_middle(_blurred(light, smooth)),
        lopsided=_lopsided(light, smooth),
    )


def _add(
    image: Image, spot: Spot, full_scale_dn: float, light: Picture, rest: Picture, count: Picture
) -> None:
    """Add what lies around the spot: light over the background, what the Gaussian leaves, pixels."""
    half = len(light) // 2
    ny, nx = image.shape
    left, top = round(spot.x_px) - half, round(spot.y_px) - half
    y0, y1, x0, x1 = max(top, 0), min(top + len(light), ny), max(left, 0), min(left + len(light), nx)
    part = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
    u, v = np.arange(x0, x1) - spot.x_px, (np.arange(y0, y1) - spot.y_px)[:, None]
    c, s = math.cos(spot.rotation_rad), math.sin(spot.rotation_rad)
    square = ((c * u + s * v) / spot.sigma_x_px) ** 2 + ((c * v - s * u) / spot.sigma_y_px) ** 2
    # integrated over the pixel, to second order, as the fit has it
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


def _middle(light: Picture) -> float:
    """Light at the centre over that of the brightest ring."""
    half = len(light) // 2
    v, u = np.indices(light.shape) - half
    radius = np.rint(np.hypot(u, v)).astype(np.int64)
    rings = np.bincount(radius.ravel(), light.ravel()) / np.maximum(np.bincount(radius.ravel()), 1)
    return float(rings[0] / max(rings[: half + 1].max(), 1e-9))


def _lopsided(light: Picture, smooth: float) -> float:
    """The largest ratio, over some directions, of the steepest slopes of the light summed across them."""
    half = len(light) // 2
    v, u = np.indices(light.shape) - half
    blur = _blur(4 * half + 2, 0.5 * smooth)
    found = 1.0
    for angle in np.arange(_DIRECTIONS) * math.pi / _DIRECTIONS:
        along = (math.cos(angle) * u + math.sin(angle) * v).ravel() + 2 * half
        place = np.floor(along).astype(np.int64)
        part = along - place
        values = light.ravel()
        # shared by the two neighbours, so that no direction has full and empty places
        total = np.bincount(place, values * (1.0 - part), 4 * half + 2)
        total[1:] += np.bincount(place, values * part, 4 * half + 2)[:-1]
        slopes = np.diff(blur @ total)[half : 3 * half + 1]
        rise, fall = float(slopes.max()), float(-slopes.min())
        if min(rise, fall) > 0:
            found = max(found, rise / fall, fall / rise)
    return found
