"""Profile of the light of a beam that is not Gaussian, learned from frames, and its fit to a frame."""

import math
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Singles
from processing.spot.fit_values import GATE, REACH, Image, chi2_limit, poor_fit_limit
from processing.spot.hot_pixels import HotPixels
from processing.spot.outcome import principal_axes
from processing.spot.profile_fit import (
    CENTRE_X,
    CENTRE_Y,
    LEVEL,
    LIGHT,
    MARGIN_PX,
    PROFILE_PARAMETERS,
    SLOPE_X,
    SLOPE_Y,
    fit_profile,
    spline_weights,
)
from processing.spot.sensor_model import LEAST_VARIANCE_DN2, PixelNoise

_MIN_SINGULAR_VALUE = 1e-10
"""Smallest singular value, relative to the largest, of a combination of knots that the grid determines."""
_KNOTS_PER_SIGMA = 8.0
"""Knots of the learned profile per standard deviation: finer structure is noise, unless the spot is small."""
LEARNING_ITERATIONS = 3
_EXCLUDED_DN = 1e18
"""Value of an excluded pixel, beyond the gate of any model; its square is finite in single precision."""
_MAX_OFFSET_PX = 2.0
"""Largest distance of the profile's centre from the Gaussian's, if both were fitted to the same spot."""


class Shape(NamedTuple):
    """Covariance matrix [[xx, xy], [xy, yy]] of the Gaussian that fits the beam best, px^2."""

    xx: float
    yy: float
    xy: float


class Sample(NamedTuple):
    """Pixels around the spot in one frame, and a Gaussian fitted to them."""

    pixels: Image
    origin_px: tuple[int, int]
    """Sensor coordinates (x, y) of the first pixel."""
    x_px: float
    y_px: float
    """Centre of the Gaussian on the sensor."""
    amplitude_dn: float
    background_dn: float


@dataclass(frozen=True, slots=True)
class BeamProfile:
    """Light of a beam on a grid of one pixel, about 1 at the peak of the Gaussian that fits the beam best."""

    spline: Singles
    """Coefficients of a cubic spline on the grid."""
    centre: Floats
    """Grid coordinates (x, y) of the Gaussian's peak."""
    half_px: tuple[int, int]
    """Half-widths (x, y) of the window that is fitted."""
    shape: Shape
    chi2_per_dof: float
    """Mean chi2/dof of the profile's fits to the samples from which it was learned."""


class ProfileFit(NamedTuple):
    """Fit of a profile to one frame."""

    p: Floats
    """Parameters as in `profile_fit`, but with the centre on the sensor."""
    chi2_per_dof: float
    used_pixels: float
    saturated: float
    """Number of pixels at full scale; 0 if the profile does not reach it."""
    outliers: float
    """Number of pixels left out because of their residual."""
    u_x_px: float
    u_y_px: float
    middle_px: tuple[float, float]
    """Middle (x, y) of the fitted window on the sensor, to which the background refers."""


def fit_at(
    profile: BeamProfile,
    pixels: Image,
    origin_px: tuple[int, int],
    start: Floats,
    noise_values: Floats,
    hot: HotPixels | None = None,
) -> ProfileFit | None:
    """Fit of a profile from the parameters `start` (centre on the sensor); None if it does not converge.

    `origin_px` are the sensor coordinates of the first pixel; `hot` pixels are left out. The window follows
    the spot, at most twice.
    """
    p = start.copy()
    ny, nx = pixels.shape
    for _ in range(3):
        if not (math.isfinite(p[CENTRE_X]) and math.isfinite(p[CENTRE_Y])):
            return None
        column, row = round(p[CENTRE_X]) - origin_px[0], round(p[CENTRE_Y]) - origin_px[1]
        x0, x1 = max(0, column - profile.half_px[0]), min(nx, column + profile.half_px[0] + 1)
        y0, y1 = max(0, row - profile.half_px[1]), min(ny, row + profile.half_px[1] + 1)
        if x1 - x0 < 5 or y1 - y0 < 5:
            return None
        window = np.ascontiguousarray(pixels[y0:y1, x0:x1], dtype=np.float32)
        left, top = x0 + origin_px[0], y0 + origin_px[1]
        excluded = hot.in_window(left, top, x1 + origin_px[0], y1 + origin_px[1]) if hot is not None else None
        if excluded is not None:
            window[excluded] = _EXCLUDED_DN
        p[CENTRE_X] -= left
        p[CENTRE_Y] -= top
        converged, chi2, used_pixels, saturated, outliers, u_x, u_y = fit_profile(
            window, profile.spline, profile.centre, p, noise_values
        )
        p[CENTRE_X] += left
        p[CENTRE_Y] += top
        shift_px = max(abs(p[CENTRE_X] - column - origin_px[0]), abs(p[CENTRE_Y] - row - origin_px[1]))
        if converged and shift_px <= 1.0:
            if excluded is not None:
                window[excluded] = 0.0
                outliers = max(outliers - len(excluded[0]), 0.0)
            if saturated > 0:
                saturated = float(np.count_nonzero(window >= PixelNoise(*noise_values).full_scale_dn))
            return ProfileFit(
                p,
                chi2 / max(used_pixels - PROFILE_PARAMETERS, 1.0),
                used_pixels,
                saturated,
                outliers,
                u_x,
                u_y,
                (left + 0.5 * (x1 - x0 - 1), top + 0.5 * (y1 - y0 - 1)),
            )
        if not shift_px > 1.0:
            return None
    return None


def learn(
    samples: Sequence[Sample], shape: Shape, noise: PixelNoise
) -> Generator[None, None, BeamProfile | None]:
    """Learn the profile of the beam from some samples; None if it cannot be fitted to them.

    The first profile is the Gaussian that fits best. In each iteration the profile is fitted to all
    samples, and the residuals, averaged over their sub-pixel shifts, are added to it. Where the model reaches
    full scale there are no residuals, and the Gaussian remains. The generator yields after steps of about
    equal duration, so that frames can be tracked in between.
    """
    noise_values = np.array(noise)
    half_px = math.ceil(REACH * math.sqrt(shape.xx)), math.ceil(REACH * math.sqrt(shape.yy))
    size_x, size_y = (2 * (half + MARGIN_PX) + 1 for half in half_px)
    centre = np.array([half_px[0] + MARGIN_PX, half_px[1] + MARGIN_PX], dtype=np.float64)
    to_spline_x = _to_spline(size_x, math.sqrt(shape.xx))
    to_spline_y = _to_spline(size_y, math.sqrt(shape.yy))
    spline = to_spline_y @ _gaussian(size_x, size_y, centre, shape) @ to_spline_x.T
    yield
    starts = [np.array([s.amplitude_dn, s.x_px, s.y_px, s.background_dn, 0.0, 0.0]) for s in samples]
    for count in range(LEARNING_ITERATIONS + 1):
        profile = BeamProfile(spline.astype(np.float32), centre, half_px, shape, math.nan)
        residuals = _MeanResidual(profile, noise)
        chi2_per_dof = offset_x = offset_y = 0.0
        for k, sample in enumerate(samples):
            fit = fit_at(profile, sample.pixels, sample.origin_px, starts[k], noise_values)
            if fit is None:
                return None
            starts[k] = fit.p
            chi2_per_dof += fit.chi2_per_dof / len(samples)
            offset_x += (fit.p[CENTRE_X] - sample.x_px) / len(samples)
            offset_y += (fit.p[CENTRE_Y] - sample.y_px) / len(samples)
            if count < LEARNING_ITERATIONS:
                residuals.add(sample, fit)
            yield
        if count < LEARNING_ITERATIONS:
            spline = spline + to_spline_y @ residuals.mean @ to_spline_x.T
    if max(abs(offset_x), abs(offset_y)) > _MAX_OFFSET_PX:
        return None
    # the centre is where the Gaussian has it, so that the position does not jump at the change
    return BeamProfile(profile.spline, centre - (offset_x, offset_y), half_px, shape, chi2_per_dof)


def dark_variance(level_dn: float, noise: PixelNoise) -> float:
    """Variance in DN^2 of a pixel that receives only the background.

    It repeats `background_variance` of the kernels, whose compilation for Python would take longer.
    """
    return max(noise.at_zero_dn2 + level_dn * noise.dn_per_e, LEAST_VARIANCE_DN2)


def compile_kernels(noise: PixelNoise) -> None:
    """Learn a small synthetic beam once, so that no frames are lost while the kernels are compiled."""
    shape = Shape(4.0, 4.0, 0.0)
    light = np.rint(0.5 * noise.full_scale_dn * _gaussian(33, 33, np.array([16.0, 16.0]), shape))
    sample = Sample(light.astype(np.uint16), (0, 0), 16.0, 16.0, 0.5 * noise.full_scale_dn, 0.0)
    deque(learn([sample], shape, noise), maxlen=0)
    principal_axes(*shape)
    poor_fit_limit(1.0)
    chi2_limit(1.0)


class _MeanResidual:
    """Mean of the fits' residuals, relative to the amplitude, on the profile's grid; 0 where none is."""

    def __init__(self, profile: BeamProfile, noise: PixelNoise) -> None:
        self._profile = profile
        self._noise = noise
        self._total = np.zeros(profile.spline.shape)
        self._count = np.zeros(profile.spline.shape)

    def add(self, sample: Sample, fit: ProfileFit) -> None:
        """Add one sample, interpolated to the grid points between its pixels."""
        start_x = self._profile.centre[0] - (fit.p[CENTRE_X] - sample.origin_px[0])
        start_y = self._profile.centre[1] - (fit.p[CENTRE_Y] - sample.origin_px[1])
        residual = _residual(self._profile, sample, fit, self._noise, start_x, start_y)
        phase_x, phase_y = math.ceil(start_x) - start_x, math.ceil(start_y) - start_y
        on_grid = _four_pixel_sums(residual, _cubic(phase_x), _cubic(phase_y))
        # interpolation begins at the second pixel
        first_x, first_y = math.ceil(start_x) + 1, math.ceil(start_y) + 1
        y0, x0 = max(first_y, 0), max(first_x, 0)
        y1 = min(first_y + len(on_grid), len(self._total))
        x1 = min(first_x + len(on_grid.T), len(self._total.T))
        on_profile = on_grid[y0 - first_y : y1 - first_y, x0 - first_x : x1 - first_x]
        is_known = np.isfinite(on_profile)
        self._total[y0:y1, x0:x1] += np.where(is_known, on_profile, 0.0)
        self._count[y0:y1, x0:x1] += is_known

    @property
    def mean(self) -> Floats:
        """Mean residual at each grid point."""
        return np.asarray(self._total / np.maximum(self._count, 1.0))


def _residual(
    profile: BeamProfile, sample: Sample, fit: ProfileFit, noise: PixelNoise, start_x: float, start_y: float
) -> Floats:
    """Sample minus fit, divided by the amplitude; NaN for pixels that the fit leaves out, and outside."""
    ny, nx = sample.pixels.shape
    light = np.full((ny, nx), np.nan)
    values = _spline_between(profile.spline, start_x % 1.0, start_y % 1.0)
    # element k of `values` belongs to the grid coordinate k + 1 + phase, pixel i to start + i
    shift_x, shift_y = math.floor(start_x) - 1, math.floor(start_y) - 1
    x0, x1 = max(0, -shift_x), min(nx, values.shape[1] - shift_x)
    y0, y1 = max(0, -shift_y), min(ny, values.shape[0] - shift_y)
    light[y0:y1, x0:x1] = fit.p[LIGHT] * values[y0 + shift_y : y1 + shift_y, x0 + shift_x : x1 + shift_x]
    column, row = np.arange(nx) + sample.origin_px[0], np.arange(ny) + sample.origin_px[1]
    middle_x, middle_y = fit.middle_px
    plane = fit.p[LEVEL] + fit.p[SLOPE_X] * (column - middle_x) + fit.p[SLOPE_Y] * (row - middle_y)[:, None]
    residual: Floats = sample.pixels - plane - light
    positive = np.maximum(light, 0.0)
    variance = dark_variance(float(fit.p[LEVEL]), noise) + positive * (
        noise.dn_per_e + positive * noise.prnu2
    )
    residual[plane + light + 3.0 * np.sqrt(variance) >= noise.full_scale_dn] = np.nan
    residual[residual**2 > GATE * max(fit.chi2_per_dof, 1.0) * variance] = np.nan
    return np.asarray(residual / fit.p[LIGHT])


def _spline_between(spline: Singles, phase_x: float, phase_y: float) -> Floats:
    """Values of a spline at `phase` beyond its grid points, from the second to the last but two."""
    weights_x, weights_y, slopes = np.empty((3, 4), dtype=np.float32)
    spline_weights(phase_x, weights_x, slopes)
    spline_weights(phase_y, weights_y, slopes)
    return _four_pixel_sums(spline, weights_x, weights_y)


def _cubic(t: float) -> list[float]:
    """Weights of four neighbours in the polynomial of third degree through them."""
    return [
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -t * (t + 1.0) * (t - 2.0) / 2.0,
        t * (t + 1.0) * (t - 1.0) / 6.0,
    ]


def _four_pixel_sums(
    image: Singles | Floats, weights_x: Sequence[float] | Singles, weights_y: Sequence[float] | Singles
) -> Floats:
    """Weighted sums of four neighbours along x and along y; the first sum is of the first four."""
    ny, nx = image.shape
    rows = np.zeros((ny - 3, nx))
    for k in range(4):
        rows += weights_y[k] * image[k : ny - 3 + k]
    sums: Floats = np.zeros((ny - 3, nx - 3))
    for k in range(4):
        sums += weights_x[k] * rows[:, k : nx - 3 + k]
    return sums


def _gaussian(size_x: int, size_y: int, centre: Floats, shape: Shape) -> Floats:
    """A Gaussian of peak 1 on the grid."""
    u = np.arange(size_x) - centre[0]
    v = (np.arange(size_y) - centre[1])[:, None]
    determinant = shape.xx * shape.yy - shape.xy**2
    square = (shape.yy * u**2 - 2.0 * shape.xy * u * v + shape.xx * v**2) / determinant
    light: Floats = np.exp(-0.5 * square)
    return light


def _to_spline(size: int, sigma_px: float) -> Floats:
    """Matrix (size, size) from values at grid points to spline coefficients. With knots further apart than a
    pixel it is the spline of least squares, expressed on the grid."""
    grid = np.arange(size, dtype=np.float64)
    values_of_spline = np.zeros((size, size))
    np.fill_diagonal(values_of_spline, 4.0 / 6.0)
    np.fill_diagonal(values_of_spline[1:], 1.0 / 6.0)
    np.fill_diagonal(values_of_spline[:, 1:], 1.0 / 6.0)
    spacing = sigma_px / _KNOTS_PER_SIGMA
    if spacing <= 1.0:
        return np.asarray(np.linalg.inv(values_of_spline))
    knots = np.arange(math.ceil((size - 1) / spacing) + 3) - 1.0
    distance = np.abs(grid[:, None] / spacing - knots)
    near = (4.0 + distance**2 * (3.0 * distance - 6.0)) / 6.0
    far = np.maximum(2.0 - distance, 0.0) ** 3 / 6.0
    coarse = np.where(distance < 1.0, near, far)
    # of two knots between the same two grid points only one combination is determined: the pseudo-inverse
    # leaves out the other
    smooth = coarse @ np.linalg.pinv(coarse, rcond=_MIN_SINGULAR_VALUE)
    return np.asarray(np.linalg.solve(values_of_spline, smooth))
