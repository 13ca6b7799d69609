"""The optics, and the pipeline from frames to spots, deflections and half-cycles, live and in replay."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame, Image
from acquisition.record.writer import RecordWriter
from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit, deflections, displacements
from processing.balance import Balance, BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import SensorModel, Spot, SpotTracker
from processing.swing import HalfCycle, TurningPointDetector
from rig.instrument.configured_camera import ObserverGuard, shutter_of
from rig.settings import Configuration

_BALANCE = "the estimate of the balance"


class Block(NamedTuple):
    """Results of some consecutive frames: one spot and one deflection per frame.

    `references` are the reference spots, if there are any. `swings` and `balances` are completed by this
    block; they may have begun in earlier blocks.
    """

    spots: list[Spot]
    deflections: Deflections
    swings: list[HalfCycle]
    balances: list[Balance]
    references: Sequence[Spot] = ()

    def write(
        self,
        writer: RecordWriter,
        numbers: Sequence[int],
        device_times_ns: Sequence[int],
        host_times_ns: Sequence[int],
    ) -> None:
        """Write the results of frames of these numbers and times into a record."""
        if numbers:
            clocks = device_times_ns, host_times_ns
            writer.write_spots(numbers, *clocks, self.spots, self.deflections, self.references)
        for swing in self.swings:
            writer.write_swing(swing)
        for balance in self.balances:
            writer.write_balance(balance)


class DualSpotTracker:
    """Trackers of the pendulum's spot and of the reference spot, each in its own part of the frames.

    The rows from `reference_row` on are those of the reference; None without one.
    """

    def __init__(self, sensor: SensorModel, reference_row: int | None = None) -> None:
        self.tracker, self._other = SpotTracker(sensor), SpotTracker(sensor)
        self.reference_row = reference_row

    def track(self, images: Sequence[Image]) -> tuple[list[Spot], list[Spot]]:
        """The pendulum's spots in consecutive frames, and the reference spots, empty without a reference."""
        row = self.reference_row
        spots = [self.tracker.track(image[:row]) for image in images]
        if row is None or row >= len(images[0]):
            return spots, []
        references = [self._other.track(image[row:]) for image in images]
        return spots, [spot._replace(y_px=spot.y_px + row) for spot in references]

    def pendulum_shape(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Shape (ny, nx) of the part of a frame of this shape that contains the pendulum's spot."""
        return shape if self.reference_row is None else (min(shape[0], self.reference_row), shape[1])


class Pipeline:
    """Tracks the spot, computes deflections and detects half-cycles, frame by frame.

    The result depends only on the frames and their timestamps, not on their division into blocks.

    Parameters
    ----------
    optics
        Calibration; each deflection gets the time of exposure of the rows that its spot lies on.
    sensor_shape
        (ny, nx) of the whole sensor; its centre is the reference if the lever states none.
    guard
        Catches errors of the estimate of the balance.
    """

    def __init__(
        self,
        optics: "Optics",
        sensor_shape: tuple[int, int],
        guard: ObserverGuard | None = None,
    ) -> None:
        self.spots = optics.dual_tracker()
        self.tracker = self.spots.tracker
        self._deflector = optics.deflector(sensor_shape)
        self._detector = TurningPointDetector()
        self._estimator = BalanceEstimator()
        self._guard = guard or ObserverGuard()

    def process(self, frames: Sequence[Frame]) -> Block:
        """Track the spot in some consecutive frames, and continue with `detect`."""
        seen = self.look(frames)
        return self.detect(seen.spots, seen.deflections)._replace(references=seen.references)

    def look(self, frames: Sequence[Frame]) -> Block:
        """Spots and deflections of some consecutive frames, without half-cycles and balances."""
        times_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        spots, references = self.spots.track([frame.image for frame in frames])
        return Block(spots, self._deflector(times_ns, spots), [], [], references)

    def measure(self, times_ns: NDArray[np.int64], spots: list[Spot]) -> Block:
        """Deflections, half-cycles and balances from spots of frames at these times."""
        return self.detect(spots, self._deflector(times_ns, spots))

    def detect(self, spots: list[Spot], deflections: Deflections) -> Block:
        """Half-cycles and balances from known deflections (replay without tracking)."""
        half_cycles = self._detector.update(deflections.times_ns, deflections.y, deflections.u_y)
        balances: list[Balance] = self._guard.call(_BALANCE, [], self._estimator.update, deflections)
        return Block(spots, deflections, half_cycles, balances)

    def finish(self) -> list[HalfCycle]:
        """Half-cycles that are completed by the end of the samples."""
        return self._detector.finish()


class DeflectionConverter:
    """Converts spots to deflections: tilts along the pendulum's axes, in rad.

    Without a lever they are displacements along the same axes in px; without stated axes along those of the
    sensor (x to the right, y upward). `reference_px` is the position (x, y) of the spot at zero tilt, `unit`
    the unit of the deflections.
    """

    def __init__(
        self, lever: Lever | None, axes: Axes, sensor_shape: tuple[int, int], shutter: Shutter = GLOBAL
    ) -> None:
        self._shutter = shutter
        self._rows = sensor_shape[0]
        self._lever = lever
        self._axes = axes
        self.unit = deflection_unit(lever)
        middle_px = (0.5 * (sensor_shape[1] - 1), 0.5 * (sensor_shape[0] - 1))
        self.reference_px = middle_px
        if lever is not None:
            self.reference_px = (
                middle_px[0] if lever.reference_x_px is None else lever.reference_x_px,
                middle_px[1] if lever.reference_y_px is None else lever.reference_y_px,
            )

    def __call__(self, times_ns: NDArray[np.int64], spots: Sequence[Spot]) -> Deflections:
        """Deflections of the spots of frames at these times."""
        table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4)
        x_px, y_px, u_x_px, u_y_px = table.T
        times_ns = self._shutter.times_ns(times_ns, y_px, self._rows)
        if self._lever is None:
            shifts = displacements(self._axes, x_px, y_px, u_x_px, u_y_px, self.reference_px)
            return Deflections(times_ns, *shifts, self.unit)
        tilts = deflections(self._lever, self._axes, x_px, y_px, u_x_px, u_y_px, self.reference_px)
        return Deflections(times_ns, *tilts, self.unit)


@dataclass(frozen=True, slots=True)
class Optics:
    """Calibrated values of the optical path; without a `lever` deflections are in px.

    Rows from `reference_row` on belong to the reference spot.
    """

    sensor: SensorModel
    lever: Lever | None
    axes: Axes
    shutter: Shutter = GLOBAL
    reference_row: int | None = None

    def dual_tracker(self) -> DualSpotTracker:
        """New trackers of the pendulum's spot and the reference spot."""
        return DualSpotTracker(self.sensor, self.reference_row)

    def deflector(self, sensor_shape: tuple[int, int]) -> DeflectionConverter:
        """The conversion of spots to deflections on a sensor of (ny, nx) pixels."""
        return DeflectionConverter(self.lever, self.axes, sensor_shape, self.shutter)

    @property
    def unit(self) -> DeflectionUnit:
        """Unit of the deflections."""
        return deflection_unit(self.lever)


def optics_of(config: Configuration, full_scale_dn: float) -> Optics:
    """The optics as configured, for a camera whose pixels saturate at `full_scale_dn`."""
    return Optics(
        sensor_model(config, full_scale_dn),
        config.lever,
        config.axes or Axes(),
        shutter_of(config),
        None if config.reference is None else config.reference.from_row_px,
    )


def sensor_model(config: Configuration, full_scale_dn: float) -> SensorModel:
    """Noise model of the sensor for the tracker.

    Without [sensor] a full well of 10 000 electrons is assumed, typical of small CMOS sensors; the
    tracker increases its uncertainties if the chi2 of its fit shows that they are too small.
    """
    if config.sensor is not None:
        return config.sensor
    return SensorModel(gain_e_per_dn=10_000.0 / full_scale_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn)
