"""How far a beam is from a Gaussian, and in what way: cut, hollow, with a ghost, ragged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.spot.spot import Image, Spot, SpotFlag

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
