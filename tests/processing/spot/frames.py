"""Frames of a spot on a sensor, calculated with scipy's error function."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from processing.spot import SensorModel, Spot

GAIN = 39.2
READ_NOISE_E = 7.0
BACKGROUND_DN = 6.0
EIGHT_BIT = SensorModel(GAIN, READ_NOISE_E, 255, pedestal_dn=BACKGROUND_DN)
TWELVE_BIT = SensorModel(GAIN / 16, READ_NOISE_E, 4095, pedestal_dn=BACKGROUND_DN)
LIT_EIGHT_BIT = SensorModel(GAIN, READ_NOISE_E, 255)
LIT_TWELVE_BIT = SensorModel(GAIN / 16, READ_NOISE_E, 4095)
"""The same where the background is light."""


def side_of(sigma_px: float) -> int:
    """Side of a frame that holds the spot and its surroundings, even."""
    return 2 * (int(5 * sigma_px) + 8)


def profile(count: int, centre: float, sigma: float) -> NDArray[np.float64]:
    """Gaussian of unit peak density integrated over each pixel."""
    edges = (np.arange(count + 1) - 0.5 - centre) / (sigma * math.sqrt(2.0))
    return sigma * math.sqrt(math.pi / 2) * np.diff(erf(edges))


def light(
    shape: tuple[int, int], x: float, y: float, sigma: float, peak: float, sigma_y: float | None = None
) -> NDArray[np.float64]:
    """Upright spot's light, DN without noise."""
    ny, nx = shape
    return peak * np.outer(profile(ny, y, sigma_y or sigma), profile(nx, x, sigma))


def tilted_light(
    shape: tuple[int, int], x: float, y: float, sigmas: tuple[float, float], angle: float, peak: float
) -> NDArray[np.float64]:
    """A tilted spot's light, integrated over each pixel by 3 x 3 Gauss points: 1e-8 at sigma 5 px."""
    points, weights = np.polynomial.legendre.leggauss(3)
    ny, nx = shape
    u = (np.arange(nx)[:, np.newaxis] + 0.5 * points).ravel() - x
    v = ((np.arange(ny)[:, np.newaxis] + 0.5 * points).ravel() - y)[:, np.newaxis]
    along = math.cos(angle) * u + math.sin(angle) * v
    across = -math.sin(angle) * u + math.cos(angle) * v
    density = np.exp(-0.5 * (along / sigmas[0]) ** 2 - 0.5 * (across / sigmas[1]) ** 2)
    of_pixels = density.reshape(ny, 3, nx, 3)
    return peak * np.einsum("iajb,a,b->ij", of_pixels, weights / 2, weights / 2)


def exposed(
    light_dn: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    sensor: SensorModel = EIGHT_BIT,
    background: float = BACKGROUND_DN,
    prnu: float = 0.0,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Shot noise, uneven pixels, read noise, rounding, clipping; background above the pedestal is light."""
    gain = sensor.gain_e_per_dn
    light_dn = light_dn + max(background - sensor.pedestal_dn, 0.0)
    background = min(background, sensor.pedestal_dn)
    expected = np.maximum(light_dn * (1.0 + prnu * rng.standard_normal(light_dn.shape)), 0.0)
    dn = rng.poisson(expected * gain) / gain + background
    dn += rng.normal(0.0, sensor.read_noise_e / gain, light_dn.shape)
    kind = np.uint8 if sensor.full_scale_dn < 256 else np.uint16
    return np.clip(np.rint(dn), 0, sensor.full_scale_dn).astype(kind)


def bound_px(
    shape: tuple[int, int],
    x: float,
    y: float,
    sigma: float,
    peak: float,
    sensor: SensorModel = EIGHT_BIT,
    prnu: float = 0.0,
) -> float:
    """Cramer-Rao bound of x for six unknowns, from numerical derivatives of the frame's light.

    Uneven pixels are new in every frame, as `exposed` draws them: a variance of (prnu light)^2 more.
    """

    def seen(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return (light(shape, p[1], p[2], p[3], p[0], p[4]) + p[5]).ravel()

    p = np.array([peak, x, y, sigma, sigma, BACKGROUND_DN])
    light_dn = seen(p) - sensor.pedestal_dn
    variance = sensor.dark_variance_dn2 + light_dn / sensor.gain_e_per_dn + (prnu * light_dn) ** 2
    slopes = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4
        slopes.append((seen(p + step) - seen(p - step)) / 2e-4)
    jacobian = np.array(slopes)
    information = (jacobian / variance) @ jacobian.T
    return math.sqrt(np.linalg.inv(information)[1, 1])


def errors_px(spots: list[Spot], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Errors (n, 2) in x and y."""
    return np.array([(spot.x_px, spot.y_px) for spot in spots]) - truth


def pulls(spots: list[Spot], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same over the uncertainties that are claimed."""
    return np.asarray(errors_px(spots, truth) / np.array([(spot.u_x_px, spot.u_y_px) for spot in spots]))


def scatter_over_claimed(spots: list[Spot], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of x and y, about a mean error that may be anything."""
    claimed = np.array([(spot.u_x_px, spot.u_y_px) for spot in spots])
    return np.asarray(errors_px(spots, truth).std(axis=0) / claimed.mean(axis=0))


def rms(values: NDArray[np.float64]) -> float:
    return math.sqrt(np.mean(values**2))


def rms_tolerance(values: int, deviations: float = 4.0) -> float:
    """Relative scatter of the RMS of so many independent normal values, times `deviations`."""
    return deviations / math.sqrt(2.0 * values)
