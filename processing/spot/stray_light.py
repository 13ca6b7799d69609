"""Light that stays where it is while the spot swings past it: a reflection, a lamp, structure of the ground.

A weak one is nothing that a fit would flag. It pulls the spot by up to 0.86 of its own strength times the
spot's sigma, at the same place in every swing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from processing.arrays import Floats
from processing.spot.spot import Image, Spot, SpotFlag

_AWAY_SIGMAS = 4.5
"""From the spot: of its own light 4e-5 is left there."""
_FEWEST = 4
"""Pictures, without the spot near a pixel, from which on it is known what is there otherwise."""
_CLEAR = 5.0
"""Shift, in standard uncertainties that the pictures leave, from which on it is none by chance."""
_WORTH = 1.0
"""Shift, in standard uncertainties of a position, from which on it matters."""


@dataclass(frozen=True, eq=False)
class FixedLight:
    """`light_dn` (ny, nx) is what stays, above its median; 0 where the spot always was.

    The brightest of it near the spot's way is at (`x_px`, `y_px`), `part` of the spot's own height.
    `shift_px` is the largest shift of the spot that follows, `in_u` the same in uncertainties of a position.
    """

    light_dn: Floats
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


def fixed_light(pictures: Sequence[tuple[Image, Spot]]) -> FixedLight | None:
    """What stays in pictures of a spot that moves; None where nothing does, or nothing that matters."""
    from scipy.ndimage import gaussian_filter

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
        away = _distance(shape, spot) > _AWAY_SIGMAS * sigma
        total += np.where(away, image, 0.0)
        count += away
    known = count >= _FEWEST
    if not known.any():
        return None
    mean = total / np.maximum(count, 1.0)
    light = np.where(known, mean - np.median(mean[known]), 0.0)
    shifts = np.array([_shift(light, spot, sigma, height) for spot in found])
    shift_px = float(np.abs(shifts).max())
    if shift_px < max(_WORTH * u_px, _CLEAR * u_px / np.sqrt(float(np.median(count[known])))):
        return None
    # of light as wide as the spot half the height is left
    smooth = 2.0 * gaussian_filter(light, sigma)
    near = reduce(np.minimum, (_distance(shape, spot) for spot in found)) < 4.0 * sigma
    y, x = np.unravel_index(int(np.argmax(np.where(near, smooth, -np.inf))), shape)
    return FixedLight(light, int(x), int(y), float(smooth[y, x]) / height, shift_px, shift_px / u_px)


def _distance(shape: tuple[int, ...], spot: Spot) -> Floats:
    y, x = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(x - spot.x_px, y - spot.y_px))


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
