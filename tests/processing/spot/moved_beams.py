"""Real beams, moved by known fractions of a pixel and exposed again."""

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Image
from processing.spot import SensorModel, SpotTracker
from tests.processing.spot.frames import exposed

COMPACT = ("TEM00_200mm.pgm", "TEM00_300mm.pgm", "k-300mm.png", "k-500mm.png", "t-510mm.pgm")
"""Images of one compact beam; the others of the folder are two lobes with a dark line between."""
_TAPER_PX = 24


class MovedImage:
    """An image that is moved by multiplying its Fourier transform by phases.

    That is exact for an image without structure finer than two pixels, dark at its border. `smooth_px` is the
    standard deviation of a Gaussian that takes from a measured image what is finer: its noise.
    """

    def __init__(self, image: NDArray[np.float64], smooth_px: float) -> None:
        self.shape = image.shape
        self._fy = np.fft.fftfreq(image.shape[0])[:, None]
        self._fx = np.fft.rfftfreq(image.shape[1])
        square = self._fx**2 + self._fy**2
        self._transform = np.fft.rfft2(image) * np.exp(-2.0 * (math.pi * smooth_px) ** 2 * square)

    def at(self, x_px: float, y_px: float) -> NDArray[np.float64]:
        """The image, moved to the right and down."""
        phase = np.exp(-2j * math.pi * (self._fx * x_px + self._fy * y_px))
        return np.asarray(np.fft.irfft2(self._transform * phase, s=self.shape))


class RealBeam:
    """A real beam on its background. `place_px` is where a Gaussian finds it, unmoved.

    With `binned` so many pixels squared are averaged first, which makes the beam smaller.
    """

    def __init__(self, path: Path, *, reach_px: int = 35, binned: int = 1) -> None:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        full = float(np.iinfo(image.dtype).max)
        gain = 10_000.0 / full
        if binned > 1:
            ny, nx = (size // binned for size in image.shape)
            parts = image[: ny * binned, : nx * binned].reshape(ny, binned, nx, binned)
            image = np.rint(parts.mean(axis=(1, 3))).astype(image.dtype)
        self.sensor = SensorModel(gain_e_per_dn=gain, read_noise_e=7.0, full_scale_dn=full)
        spot = SpotTracker(self.sensor).track(image)
        self.background_dn = float(np.median(image))
        half = math.ceil(6.0 * max(spot.sigma_x_px, spot.sigma_y_px)) + reach_px
        x, y = round(spot.x_px), round(spot.y_px)
        wide = np.pad(image - self.background_dn, half, mode="edge")[y : y + 2 * half, x : x + 2 * half]
        from_edge = np.minimum(np.arange(2 * half), np.arange(2 * half)[::-1])
        taper = np.sin(0.5 * math.pi * np.clip(from_edge / _TAPER_PX, 0.0, 1.0)) ** 2
        self._moved = MovedImage(wide * np.outer(taper, taper), 1.5)
        self.place_px = (half + spot.x_px - x, half + spot.y_px - y)
        self.half_px = 4.5 * spot.sigma_x_px, 4.5 * spot.sigma_y_px

    def light(self, x_px: float, y_px: float) -> NDArray[np.float64]:
        """Light in DN without noise, moved by (x, y)."""
        return np.maximum(self._moved.at(x_px, y_px) + self.background_dn, 0.0)

    def frame(self, x_px: float, y_px: float, rng: np.random.Generator) -> Image:
        """A frame with fresh noise."""
        return exposed(self.light(x_px, y_px), rng, sensor=self.sensor, background=0.0)

    def bound_px(self) -> NDArray[np.float64]:
        """Cramer-Rao bound of (x, y) for a known profile, with a background that is a plane."""
        light = self.light(0.0, 0.0)
        profile = light - self.background_dn
        step = 0.01
        by_x = (self.light(step, 0.0) - self.light(-step, 0.0)) / (2 * step)
        by_y = (self.light(0.0, step) - self.light(0.0, -step)) / (2 * step)
        y, x = np.indices(light.shape)
        u, v = x - self.place_px[0], y - self.place_px[1]
        sensor = self.sensor
        variance = sensor.dark_variance_dn2 + light / sensor.gain_e_per_dn
        inside = (abs(u) <= self.half_px[0]) & (abs(v) <= self.half_px[1])
        inside &= light + 3.0 * np.sqrt(variance) < sensor.full_scale_dn
        slopes = np.array([d[inside] for d in (by_x, by_y, profile, np.ones_like(u), u, v)])
        information = (slopes / variance[inside]) @ slopes.T
        return np.asarray(np.sqrt(np.linalg.inv(information)[[0, 1], [0, 1]]))
