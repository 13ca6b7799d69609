"""Widths and centres of beams: second moments as ISO 11146 defines them, and the program's spot.

On beams that are Gaussian both must be the same. On public images of real beams, by real cameras,
laserbeamsize has the second moments; there the two centres are different definitions of the place of a
lopsided beam.
"""

import importlib
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.spot import SensorModel, Spot, SpotTracker
from tests.processing.spot.frames import tilted_light
from tests.validation.outside.shared import shared
from tests.validation.row import Found, Missing

COMPACT = ("TEM00_200mm.pgm", "TEM00_300mm.pgm", "k-300mm.png", "k-500mm.png", "t-510mm.pgm")
"""Images of one compact beam."""
_GAUSSIANS = 40
_FULL_SCALE_DN = 65_535.0


def _moments(image: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Centre and the two widths, 4 roots of the principal second moments, of a picture without background."""
    y, x = np.indices(image.shape)
    light = image.sum()
    mean = np.array([(image * x).sum(), (image * y).sum()]) / light
    off = np.array([x - mean[0], y - mean[1]])
    second = np.einsum("iab,jab,ab->ij", off, off, image) / light
    narrow, wide = 4 * np.sqrt(np.linalg.eigvalsh(second))
    return float(mean[0]), float(mean[1]), float(wide), float(narrow)


def _widths(spot: Spot) -> tuple[float, float]:
    sigmas = spot.sigma_x_px, spot.sigma_y_px
    return 4 * max(sigmas), 4 * min(sigmas)


def gaussian() -> dict[str, Found]:
    """Tilted Gaussians at random places, 16 bit, no noise: widths over second moments, and centres, px."""
    rng = np.random.default_rng(11146)
    widths, centres = [], []
    sensor = SensorModel(gain_e_per_dn=0.2, read_noise_e=2.0, full_scale_dn=_FULL_SCALE_DN)
    for _ in range(_GAUSSIANS):
        sigmas = (float(rng.uniform(4, 9)), float(rng.uniform(4, 9)))
        x, y = rng.uniform(70, 90, 2)
        light = tilted_light((160, 160), x, y, sigmas, float(rng.uniform(0, math.pi)), 50_000.0)
        spot = SpotTracker(sensor).track(np.rint(light).astype(np.uint16))
        at_x, at_y, wide, narrow = _moments(light)
        widths += [w / m for w, m in zip(_widths(spot), (wide, narrow), strict=True)]
        centres.append(math.hypot(spot.x_px - at_x, spot.y_px - at_y))
    # a pixel adds the variance of its own width to the second moments, 1/12, which the program does not count
    return {
        "widths": Found((min(widths), max(widths)), f"{_GAUSSIANS} beams, standard deviations of 4 to 9 px"),
        "centres": Found((max(centres),), f"{_GAUSSIANS} beams"),
    }


def public_beams() -> dict[str, Found]:
    """Ratio of widths, and distance of centres over the beam's diameter, on five public images."""
    try:
        beam_size = importlib.import_module("laserbeamsize").beam_size
    except ImportError:
        raise Missing('laserbeamsize: pip install ".[bench]"') from None
    folder = shared("beams")
    ratios: dict[str, tuple[float, float]] = {}
    away: dict[str, float] = {}
    for name in COMPACT:
        image: Any = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
        assert image is not None
        full_scale_dn = float(np.iinfo(image.dtype).max)
        spot = SpotTracker(SensorModel(1e4 / full_scale_dn, 7.0, full_scale_dn)).track(image)
        # its other way to subtract the background ends with no beam on four of these images
        x, y, *both, _ = beam_size(image, iso_noise=False)
        wide, narrow = max(both), min(both)
        ratios[name] = (_widths(spot)[0] / wide, _widths(spot)[1] / narrow)
        away[name] = 100 * math.hypot(spot.x_px - x, spot.y_px - y) / math.sqrt(wide * narrow)
    every = [ratio for both in ratios.values() for ratio in both]
    farthest = max(away, key=lambda name: away[name])
    return {
        "widths": Found((float(min(every)), float(max(every))), f"{len(COMPACT)} images, two widths each"),
        "centres": Found((away[farthest],), f"the farthest, {farthest}"),
    }
