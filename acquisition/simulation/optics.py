"""Light lever and laser spot: position of the beam on the sensor, and electrons in each pixel."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import AxesTruth, OpticsTruth, SensorTruth
from processing.kernel import kernel

FAINTEST_E = 1e-3
"""Light of fewer electrons per pixel than this is neglected."""

_GAUSS_3 = math.sqrt(0.6)
"""Outer node of the three-point Gauss rule on (-1, 1); weights 5/18, 8/18, 5/18 on a unit interval."""


class GaussianBeam(NamedTuple):
    """One elliptical Gaussian beam: centre and standard deviations in px, peak in e- per pixel."""

    x_px: float
    y_px: float
    sigma_x_px: float
    sigma_y_px: float
    rotation_rad: float
    peak_e: float


def spot_position_px(
    x_rad: NDArray[np.float64],
    y_rad: NDArray[np.float64],
    times_s: NDArray[np.float64],
    axes: AxesTruth,
    optics: OpticsTruth,
    sensor: SensorTruth,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre of the spot on the sensor in px (x to the right, y down), for tilts (n,) along the pendulum's
    axes.

    The tilt of each mode moves the spot along the mode's direction (see `AxesTruth`) by ``arm tan(2 tilt)``.
    """
    per_px = optics.arm_m / sensor.pixel_pitch_m
    along_fast = per_px * np.tan(2.0 * x_rad)
    along_slow = per_px * np.tan(2.0 * y_rad)
    slow = axes.slow_angle_rad + axes.spin_rad_per_s * times_s
    fast = slow + 0.5 * math.pi + axes.non_orthogonality_rad
    hand = -1.0 if axes.mirrored else 1.0
    middle_x = 0.5 * (sensor.width_px - 1) if optics.reference_x_px is None else optics.reference_x_px
    middle_y = 0.5 * (sensor.height_px - 1) if optics.reference_y_px is None else optics.reference_y_px
    return (
        middle_x + along_slow * np.sin(slow) + hand * along_fast * np.sin(fast),
        middle_y - along_slow * np.cos(slow) - hand * along_fast * np.cos(fast),
    )


@kernel
def beam_reach(beam: GaussianBeam) -> float:
    """Distance from the centre, in standard deviations, at which a pixel gets `FAINTEST_E`."""
    return math.sqrt(2.0 * math.log(beam.peak_e / FAINTEST_E)) + 0.5


@kernel
def beam_box(beam: GaussianBeam, ny: int, nx: int) -> tuple[int, int, int, int]:
    """Rows y0 <= y < y1 and columns x0 <= x < x1 with light of the beam, as (y0, y1, x0, x1); empty if
    none.
    """
    if not beam.peak_e > FAINTEST_E or not math.isfinite(beam.x_px + beam.y_px):
        return 0, 0, 0, 0
    reach = beam_reach(beam)
    cos = math.cos(beam.rotation_rad)
    sin = math.sin(beam.rotation_rad)
    half_x = 0.5 + reach * math.sqrt((beam.sigma_x_px * cos) ** 2 + (beam.sigma_y_px * sin) ** 2)
    half_y = 0.5 + reach * math.sqrt((beam.sigma_x_px * sin) ** 2 + (beam.sigma_y_px * cos) ** 2)
    x0 = min(max(math.floor(beam.x_px - half_x), 0.0), float(nx))
    x1 = max(min(math.ceil(beam.x_px + half_x) + 1.0, float(nx)), x0)
    y0 = min(max(math.floor(beam.y_px - half_y), 0.0), float(ny))
    y1 = max(min(math.ceil(beam.y_px + half_y) + 1.0, float(ny)), y0)
    if x0 == x1 or y0 == y1:
        return 0, 0, 0, 0
    return int(y0), int(y1), int(x0), int(x1)


@kernel
def add_beam(light_e: NDArray[np.float64], beam: GaussianBeam, y0: int, y1: int, x0: int, x1: int) -> None:
    """Add the beam, integrated over each pixel, to light_e[y0:y1, x0:x1].

    For an upright ellipse the integral is exactly a product of differences of error functions. A rotated one
    is integrated with 3 x 3 Gauss nodes per pixel (error below 1e-7 of the peak for sigma >= 2). Along a row,
    each value follows from the one before by a ratio, which itself changes by a constant factor.
    """
    if y0 == y1 or x0 == x1:
        return
    cos = math.cos(beam.rotation_rad)
    sin = math.sin(beam.rotation_rad)
    if sin == 0.0 or beam.sigma_x_px == beam.sigma_y_px:
        across = np.empty(x1 - x0)
        _integrals(across, beam.x_px - x0, beam.sigma_x_px)
        down = np.empty(y1 - y0)
        _integrals(down, beam.y_px - y0, beam.sigma_y_px)
        for y in range(y0, y1):
            factor = beam.peak_e * down[y - y0]
            line = light_e[y]
            for x in range(x0, x1):
                line[x] += factor * across[x - x0]
        return
    wx = 1.0 / beam.sigma_x_px**2
    wy = 1.0 / beam.sigma_y_px**2
    qxx = wx * cos * cos + wy * sin * sin
    qyy = wx * sin * sin + wy * cos * cos
    qxy = (wx - wy) * sin * cos
    shrink = math.exp(-qxx)
    # the recursion begins where the row has light: far outside, the first value would underflow
    half_x = 1.5 + beam_reach(beam) / math.sqrt(qxx)
    for y in range(y0, y1):
        line = light_e[y]
        for j in range(-1, 2):
            dy = y + 0.5 * _GAUSS_3 * j - beam.y_px
            middle_x = beam.x_px - qxy / qxx * dy
            begin = int(min(max(math.floor(middle_x - half_x), float(x0)), float(x1)))
            end = int(min(max(math.ceil(middle_x + half_x), float(x0)), float(x1)))
            height = beam.peak_e * (8.0 / 18.0 if j == 0 else 5.0 / 18.0)
            left, middle, right = begin - 0.5 * _GAUSS_3, float(begin), begin + 0.5 * _GAUSS_3
            # three independent recursions, which the processor evaluates in parallel
            value_l, ratio_l = _row_start(height * 5.0 / 18.0, left - beam.x_px, dy, qxx, qxy, qyy)
            value_m, ratio_m = _row_start(height * 8.0 / 18.0, middle - beam.x_px, dy, qxx, qxy, qyy)
            value_r, ratio_r = _row_start(height * 5.0 / 18.0, right - beam.x_px, dy, qxx, qxy, qyy)
            for x in range(begin, end):
                line[x] += value_l + value_m + value_r
                value_l *= ratio_l
                value_m *= ratio_m
                value_r *= ratio_r
                ratio_l *= shrink
                ratio_m *= shrink
                ratio_r *= shrink


@kernel
def _row_start(
    height: float, dx: float, dy: float, qxx: float, qxy: float, qyy: float
) -> tuple[float, float]:
    """The Gaussian at the first node of a row, and the ratio of the next pixel's value to it."""
    value = height * math.exp(-0.5 * (qxx * dx * dx + qyy * dy * dy) - qxy * dx * dy)
    return value, math.exp(-qxx * (dx + 0.5) - qxy * dy)


@kernel
def _integrals(out: NDArray[np.float64], centre_px: float, sigma_px: float) -> None:
    """Gaussian of unit height integrated over the pixels 0, 1, ... of a line."""
    scale = 1.0 / (math.sqrt(2.0) * sigma_px)
    height = math.sqrt(0.5 * math.pi) * sigma_px
    before = math.erf((-0.5 - centre_px) * scale)
    for i in range(out.shape[0]):
        after = math.erf((i + 0.5 - centre_px) * scale)
        out[i] = height * (after - before)
        before = after
