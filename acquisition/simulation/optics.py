"""Light lever and laser spot: position of the beam on the sensor, and electrons in each pixel."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import AxesTruth, OpticsTruth, SensorTruth
from processing.errors import ConfigurationError
from processing.kernel import kernel

MIN_LIGHT_E = 1e-3
"""Smallest light in electrons per pixel that is not neglected."""

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
    fast_rad: NDArray[np.float64],
    slow_rad: NDArray[np.float64],
    times_s: NDArray[np.float64],
    axes: AxesTruth,
    optics: OpticsTruth,
    sensor: SensorTruth,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (x, y) of the spot on the sensor in px, for tilts (n,) of the two modes.

    The tilt of each mode moves the spot along the mode's direction (see `AxesTruth`) by ``arm tan(2 tilt)``.
    """
    arm_px = optics.arm_m / sensor.pixel_pitch_m
    along_fast = arm_px * np.tan(2.0 * fast_rad)
    along_slow = arm_px * np.tan(2.0 * slow_rad)
    slow = axes.slow_angle_rad + axes.spin_rad_per_s * times_s
    fast = slow + 0.5 * math.pi + axes.non_orthogonality_rad
    mirror_sign = -1.0 if axes.mirrored else 1.0
    middle_x = 0.5 * (sensor.width_px - 1) if optics.reference_x_px is None else optics.reference_x_px
    middle_y = 0.5 * (sensor.height_px - 1) if optics.reference_y_px is None else optics.reference_y_px
    return (
        middle_x + along_slow * np.sin(slow) + mirror_sign * along_fast * np.sin(fast),
        middle_y - along_slow * np.cos(slow) - mirror_sign * along_fast * np.cos(fast),
    )


@kernel
def beam_reach(beam: GaussianBeam) -> float:
    """Distance from the centre, in standard deviations, at which a pixel receives `MIN_LIGHT_E`."""
    return math.sqrt(2.0 * math.log(beam.peak_e / MIN_LIGHT_E)) + 0.5


@kernel
def beam_box(beam: GaussianBeam, ny: int, nx: int) -> tuple[int, int, int, int]:
    """Rows y0 <= y < y1 and columns x0 <= x < x1 with light of the beam, as (y0, y1, x0, x1); 0s if none."""
    if not beam.peak_e > MIN_LIGHT_E or not math.isfinite(beam.x_px + beam.y_px):
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


_NODES = 9
"""Number of times in a readout at which the motion is calculated; a polynomial goes through the positions."""
_FIXED_POINT_ITERATIONS = 12


class RollingReadout:
    """The readout of a region of `rows` rows from row `top` of the sensor on."""

    def __init__(self, truth: SensorTruth, top: int, rows: int, frame_rate_hz: float) -> None:
        self._span_s = truth.row_time_s * (rows - 1)
        if self._span_s * frame_rate_hz > 1.0:
            raise ConfigurationError(
                f"simulation.sensor.row_time_s = {truth.row_time_s:g}: {rows} rows take {self._span_s:.4g} s,"
                f" more than a frame at {frame_rate_hz:g} Hz; lower camera.frame_rate_hz or height_px"
            )
        first, last = (top, top + rows - 1) if truth.first_row == "top" else (top + rows - 1, top)
        # a region of one row is exposed at one time, whatever the length stated here
        self._first, self._length = first, last - first or 1
        self._fractions = np.linspace(0.0, 1.0, _NODES)
        self._to_polynomial = np.linalg.inv(np.vander(self._fractions, increasing=True))

    def times_s(self, frame_times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Increasing times (n * nodes,) within the readouts of frames whose first rows have these times."""
        times: NDArray[np.float64] = (frame_times_s[:, None] + self._span_s * self._fractions).ravel()
        return times

    def at_exposure(self, moving_px: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position of the spot when its own rows are exposed, (n, 2), and motion per row, (n, 2), in px.

        `moving_px` (n, nodes, 2) is its position at `times_s`. For a spot outside the region the nearest row
        is used.
        """
        # the spot's own place left out: rounding of hundreds of px would be a motion of a spot at rest
        place_px = moving_px[:, 0]
        path = np.einsum("kj,njc->nkc", self._to_polynomial, moving_px - place_px[:, None])
        path[:, 0] += place_px
        fraction = np.full(len(path), 0.5)
        for _ in range(_FIXED_POINT_ITERATIONS):
            y_px = self._along(path, fraction)[:, 1]
            fraction = np.clip((y_px - self._first) / self._length, 0.0, 1.0)
        powers = np.arange(1, _NODES)
        rate_px = np.einsum("nkc,nk->nc", path[:, 1:] * powers[:, None], fraction[:, None] ** (powers - 1))
        return self._along(path, fraction), rate_px / self._length

    def row_begins_s(self, y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Time in s from the begin of the first row's exposure to that of the row at `y_px` of the sensor."""
        begins: NDArray[np.float64] = self._span_s * (y_px - self._first) / self._length
        return begins

    @staticmethod
    def _along(path: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position (n, 2) in px at a fraction (n,) of the readout."""
        position: NDArray[np.float64] = np.einsum("nkc,nk->nc", path, fraction[:, None] ** np.arange(_NODES))
        return position


def sheared_beams(
    optics: OpticsTruth, slope: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shapes (n, 3) and offsets of the ghost (n, 2) px, of a beam that moves by `slope` (n, 2) px per row.

    A shape is the standard deviations in px along two axes, and the angle of the first from x. The rows of
    the ghost are exposed at another time than those of the spot.
    """
    sx, sy = slope.T
    stretch = 1.0 / (1.0 - sy)
    ghost_dy_px = optics.ghost_dy_px / (1.0 - sy)
    ghost_px = np.column_stack((optics.ghost_dx_px + sx * ghost_dy_px, ghost_dy_px))
    if not slope.any():
        return np.tile((optics.sigma_x_px, optics.sigma_y_px, optics.rotation_rad), (len(slope), 1)), ghost_px
    cos, sin = math.cos(optics.rotation_rad), math.sin(optics.rotation_rad)
    rotation = np.array([[cos, -sin], [sin, cos]])
    covariance = rotation @ np.diag([optics.sigma_x_px**2, optics.sigma_y_px**2]) @ rotation.T
    # a pixel at (dx, dy) from the centre receives the beam's light at (dx - sx dy, dy - sy dy)
    to_image = np.zeros((len(sx), 2, 2))
    to_image[:, 0, 0], to_image[:, 0, 1], to_image[:, 1, 1] = 1.0, sx * stretch, stretch
    variance, axes = np.linalg.eigh(to_image @ covariance @ to_image.transpose(0, 2, 1))
    return np.column_stack((np.sqrt(variance), np.arctan2(axes[:, 1, 0], axes[:, 0, 0]))), ghost_px
