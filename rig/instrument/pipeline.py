"""Frame -> Spot -> Deflection -> Swing: the same object live, in replay and in tests."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from calibration.axes import Axes, deflections
from calibration.lever import Lever
from processing.balance import Balance, BalanceEstimator
from processing.spot import Spot, SpotTracker
from processing.swing import Swing, SwingDetector


class Block(NamedTuple):
    """What became of some consecutive frames; arrays have one entry a frame.

    Deflections are NaN where the spot was lost. `swings` and `balances` are those completed by
    this block, which may belong to earlier frames.
    """

    times_ns: NDArray[np.int64]
    spots: list[Spot]
    x_rad: NDArray[np.float64]
    y_rad: NDArray[np.float64]
    u_x_rad: NDArray[np.float64]
    u_y_rad: NDArray[np.float64]
    swings: list[Swing]
    balances: list[Balance]


class Pipeline:
    """Synchronous and without a clock: what comes out depends on the frames alone, not on their blocks.

    Parameters
    ----------
    tracker
        Follows the spot; holds the last one.
    lever, axes
        Calibration. `lever` None: no calibration exists, "deflections" are then in px along the
        sensor's axes, y upward.
    sensor_shape
        (ny, nx) of the whole sensor, whose middle is the reference where the lever states none.
    """

    def __init__(
        self, tracker: SpotTracker, lever: Lever | None, axes: Axes, sensor_shape: tuple[int, int]
    ) -> None:
        self.tracker = tracker
        self._deflector = Deflector(lever, axes, sensor_shape)
        self._sensor_shape = sensor_shape
        self._detector = SwingDetector()
        self._balance = BalanceEstimator()

    def process(self, frames: Sequence[Frame], origins_px: Sequence[tuple[int, int]] | None = None) -> Block:
        """Track and measure some frames, in order.

        `origins_px` are the sensor coordinates (x, y) of each image's first pixel, where images are
        windows cut out of the sensor; None: whole frames.
        """
        if origins_px is None:
            spots = [self.tracker.track(frame.image) for frame in frames]
        else:
            spots = [
                self.tracker.track(frame.image, origin, self._sensor_shape)
                for frame, origin in zip(frames, origins_px, strict=True)
            ]
        return self.measure(np.array([frame.time_ns for frame in frames], dtype=np.int64), spots)

    def measure(self, times_ns: NDArray[np.int64], spots: list[Spot]) -> Block:
        """Everything after the tracker, for spots that are known already."""
        x_rad, y_rad, u_x_rad, u_y_rad = self._deflector(spots)
        return self.detect(times_ns, spots, x_rad, y_rad, u_x_rad, u_y_rad)

    def detect(
        self,
        times_ns: NDArray[np.int64],
        spots: list[Spot],
        x_rad: NDArray[np.float64],
        y_rad: NDArray[np.float64],
        u_x_rad: NDArray[np.float64],
        u_y_rad: NDArray[np.float64],
    ) -> Block:
        """Swings and balance from deflections that are known already (replay without tracking)."""
        swings = self._detector.update(times_ns, y_rad, u_y_rad)
        balances = self._balance.update(times_ns, x_rad, y_rad, u_x_rad, u_y_rad)
        return Block(times_ns, spots, x_rad, y_rad, u_x_rad, u_y_rad, swings, balances)

    def finish(self) -> list[Swing]:
        """Swings that the end of the samples completes."""
        return self._detector.finish()


class Deflector:
    """Spots -> tilts, or, without a lever, displacements in px (y upward).

    `reference_px` is the spot (x, y) at zero tilt.
    """

    def __init__(self, lever: Lever | None, axes: Axes, sensor_shape: tuple[int, int]) -> None:
        self._lever = lever
        self._axes = axes
        middle_px = (0.5 * (sensor_shape[1] - 1), 0.5 * (sensor_shape[0] - 1))
        self.reference_px = middle_px
        if lever is not None:
            self.reference_px = (
                middle_px[0] if lever.reference_x_px is None else lever.reference_x_px,
                middle_px[1] if lever.reference_y_px is None else lever.reference_y_px,
            )

    def __call__(
        self, spots: Sequence[Spot]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4)
        x_px, y_px, u_x_px, u_y_px = table.T
        if self._lever is None:
            return x_px - self.reference_px[0], self.reference_px[1] - y_px, u_x_px.copy(), u_y_px.copy()
        return deflections(self._lever, self._axes, x_px, y_px, u_x_px, u_y_px, self.reference_px)
