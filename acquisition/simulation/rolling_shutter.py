"""Rolling shutter: each row of the sensor sees the spot at its own time.

While a spot of some ten rows is read out it moves evenly, so that its image is a sheared Gaussian beam, which
is again one of another shape.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import OpticsTruth, SensorTruth
from processing.errors import ConfigurationError

_NODES = 9
_ROUNDS = 12


class RollingReadout:
    """The readout of a region of `rows` rows from row `top` of the sensor on."""

    def __init__(self, truth: SensorTruth, top: int, rows: int, frame_rate_hz: float) -> None:
        self._span_s = truth.row_time_s * (rows - 1)
        if self._span_s * frame_rate_hz > 1.0:
            raise ConfigurationError(
                f"simulation.sensor.row_time_s = {truth.row_time_s:g}: {rows} rows take {self._span_s:.4g} s,"
                f" more than a frame at {frame_rate_hz:g} Hz; lower camera.frame_rate_hz or height_px"
            )
        self._from_top = truth.first_row == "top"
        self._first, self._last = (top, top + rows - 1) if self._from_top else (top + rows - 1, top)
        # part of the readout at which the motion is calculated; a polynomial goes through these points
        self._part = np.linspace(0.0, 1.0, _NODES)
        self._to_polynomial = np.linalg.inv(np.vander(self._part, increasing=True))

    def times_s(self, frame_times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Increasing times (n * nodes,) within the readouts of frames whose first rows have these times."""
        times: NDArray[np.float64] = (frame_times_s[:, None] + self._span_s * self._part).ravel()
        return times

    def seen(self, moving_px: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where the rows under the spot see it, (n, 2), and how far it moves from row to row, (n, 2), in px.

        `moving_px` (n, nodes, 2) is its position at `times_s`. A spot beside the region is where the nearest
        row would see it.
        """
        path = np.einsum("kj,njc->nkc", self._to_polynomial, moving_px)
        part = np.full(len(path), 0.5)
        for _ in range(_ROUNDS):
            y_px = self._along(path, part)[:, 1]
            part = np.clip((y_px - self._first) / (self._last - self._first), 0.0, 1.0)
        powers = np.arange(1, _NODES)
        by_part = np.einsum("nkc,nk->nc", path[:, 1:] * powers[:, None], part[:, None] ** (powers - 1))
        return self._along(path, part), by_part / (self._last - self._first)

    def row_begins_s(self, y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """From the beginning of the first row's exposure to that of the row at `y_px` of the sensor."""
        begins: NDArray[np.float64] = self._span_s * (y_px - self._first) / (self._last - self._first)
        return begins

    @staticmethod
    def _along(path: NDArray[np.float64], part: NDArray[np.float64]) -> NDArray[np.float64]:
        position: NDArray[np.float64] = np.einsum("nkc,nk->nc", path, part[:, None] ** np.arange(_NODES))
        return position


@dataclass(frozen=True, slots=True)
class Sheared:
    """Shapes of a beam that moves by `slope` (n, 2) px in x and y from one row to the next."""

    optics: OpticsTruth
    slope: NDArray[np.float64]

    @property
    def ghost_dx_px(self) -> NDArray[np.float64]:
        """Offset of the ghost in x, (n,): its rows are exposed later than those of the spot."""
        return self.optics.ghost_dx_px + self.slope[:, 0] * self.ghost_dy_px

    @property
    def ghost_dy_px(self) -> NDArray[np.float64]:
        """Offset of the ghost in y, (n,)."""
        dy: NDArray[np.float64] = self.optics.ghost_dy_px / (1.0 - self.slope[:, 1])
        return dy

    @property
    def shapes(self) -> NDArray[np.float64]:
        """Standard deviations in px along two axes, and the angle of the first from x, (n, 3)."""
        optics = self.optics
        plain = optics.sigma_x_px, optics.sigma_y_px, optics.rotation_rad
        if not self.slope.any():
            return np.tile(plain, (len(self.slope), 1))
        cos, sin = math.cos(optics.rotation_rad), math.sin(optics.rotation_rad)
        turn = np.array([[cos, -sin], [sin, cos]])
        covariance = turn @ np.diag([optics.sigma_x_px**2, optics.sigma_y_px**2]) @ turn.T
        # a point at (dx, dy) from the centre shows the light of (dx - sx dy, dy - sy dy)
        sx, sy = self.slope.T
        stretch = 1.0 / (1.0 - sy)
        to_image = np.zeros((len(sx), 2, 2))
        to_image[:, 0, 0], to_image[:, 0, 1], to_image[:, 1, 1] = 1.0, sx * stretch, stretch
        seen = to_image @ covariance @ to_image.transpose(0, 2, 1)
        variance, axes = np.linalg.eigh(seen)
        angle_rad = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
        return np.column_stack((np.sqrt(variance), angle_rad))
