"""The optics, and the pipeline from frames to spots, deflections and half-cycles, live and in replay."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame, Image
from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit, deflections, displacements
from processing.balance import Balance, BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.spot import SensorModel, Spot, SpotTracker
from processing.swing import HalfCycle, TurningPointDetector
from rig.instrument.configured_camera import ObserverGuard, shutter_of
from rig.settings import Configuration

if TYPE_CHECKING:  # a fit writes no record
    from acquisition.record.writer import RecordWriter

_MAX_PENDING_CALLS = 4096
_BATCH_NS = 50_000_000
"""Time span of samples that a thread gets together: at 1000 frames/s single frames would cost more."""
_BALANCE = "the estimate of the balance"

Estimates: TypeAlias = tuple[list[HalfCycle], list[Balance]]


class EstimateThread:
    """A thread that calls `estimate` on batches of samples in order, so that frames do not wait for it.

    One estimate takes as long as many frames. The estimates are the same as without the thread, since they do
    not depend on how samples are divided. A later call raises the error of an estimate. `update` waits only
    while thousands of calls are pending.
    """

    def __init__(self, estimate: Callable[[Deflections], Estimates]) -> None:
        self._estimate = estimate
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="half-cycles")
        self._batch: list[Deflections] = []
        self._pending: deque[Future[Estimates]] = deque()

    def update(self, samples: Deflections) -> Estimates:
        """Add samples; returns the estimates that have become ready since the last call."""
        if len(samples):
            self._batch.append(samples)
            if samples.times_ns[-1] - self._batch[0].times_ns[0] >= _BATCH_NS:
                self._hand_over()
        finished = []
        while self._pending and (self._pending[0].done() or len(self._pending) > _MAX_PENDING_CALLS):
            finished.append(self._pending.popleft().result())
        return _joined_estimates(finished)

    def finish(self) -> Estimates:
        """Wait for the estimates that are still being made, and return them."""
        self._hand_over()
        finished = [pending.result() for pending in self._pending]
        self._pending.clear()
        return _joined_estimates(finished)

    def _hand_over(self) -> None:
        if self._batch:
            samples, self._batch = joined(self._batch, self._batch[0].unit), []
            self._pending.append(self._executor.submit(self._estimate, samples))


def _joined_estimates(parts: Iterable[Estimates]) -> Estimates:
    half_cycles: list[HalfCycle] = []
    balances: list[Balance] = []
    for new_half_cycles, new_balances in parts:
        half_cycles += new_half_cycles
        balances += new_balances
    return half_cycles, balances


class Block(NamedTuple):
    """Results of some consecutive frames: one spot and one deflection per frame."""

    spots: list[Spot]
    deflections: Deflections
    half_cycles: list[HalfCycle]
    """Half-cycles that this block completes; they may have begun in earlier blocks."""
    balances: list[Balance]
    """Balances that this block completes."""
    references: Sequence[Spot] = ()
    """Spots of the reference, if there is one."""

    def write(
        self,
        writer: "RecordWriter",
        numbers: Sequence[int],
        device_times_ns: Sequence[int],
        host_times_ns: Sequence[int],
    ) -> None:
        """Write the results of frames of these numbers and times into a record."""
        if numbers:
            clocks = device_times_ns, host_times_ns
            writer.write_spots(numbers, *clocks, self.spots, self.deflections, self.references)
        for half_cycle in self.half_cycles:
            writer.write_half_cycle(half_cycle)
        for balance in self.balances:
            writer.write_balance(balance)


class DualSpotTracker:
    """Trackers of the pendulum's spot and of the reference spot, each in its own part of the frames.

    The rows from `reference_row` on are those of the reference; None without one.
    """

    def __init__(self, sensor: SensorModel, reference_row: int | None = None) -> None:
        self.tracker, self._reference_tracker = SpotTracker(sensor), SpotTracker(sensor)
        self.reference_row = reference_row

    def track(self, images: Sequence[Image]) -> tuple[list[Spot], list[Spot]]:
        """The pendulum's spots in consecutive frames, and the reference spots, empty without a reference."""
        row = self.reference_row
        spots = [self.tracker.track(image[:row]) for image in images]
        if row is None or row >= len(images[0]):
            return spots, []
        references = [self._reference_tracker.track(image[row:]) for image in images]
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
    threaded
        Whether half-cycles and balances are estimated in a thread of their own. They are the same, but come
        with a later block, the last ones with `finish`.
    guard
        Catches errors of the estimate of the balance.
    """

    def __init__(
        self,
        optics: "Optics",
        sensor_shape: tuple[int, int],
        *,
        threaded: bool = False,
        guard: ObserverGuard | None = None,
    ) -> None:
        self.spots = optics.dual_tracker()
        self.tracker = self.spots.tracker
        self._deflector = optics.deflector(sensor_shape)
        self._detector = TurningPointDetector()
        self._estimator = BalanceEstimator()
        self._guard = guard or ObserverGuard()
        self._thread = EstimateThread(self._estimates) if threaded else None

    def process(self, frames: Sequence[Frame]) -> Block:
        """Track the spot in some consecutive frames, and continue with `detect`."""
        block = self.look(frames)
        return self.detect(block.spots, block.deflections)._replace(references=block.references)

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
        estimate = self._estimates if self._thread is None else self._thread.update
        return Block(spots, deflections, *estimate(deflections))

    def _estimates(self, samples: Deflections) -> Estimates:
        half_cycles = self._detector.update(samples.times_ns, samples.y, samples.u_y)
        balances: list[Balance] = self._guard.call(_BALANCE, [], self._estimator.update, samples)
        return half_cycles, balances

    def finish(self) -> Estimates:
        """Half-cycles that the end of the samples completes, and the estimates that are still being made."""
        half_cycles, balances = ([], []) if self._thread is None else self._thread.finish()
        return [*half_cycles, *self._detector.finish()], balances


class DeflectionConverter:
    """Converts spots to deflections: tilts along the pendulum's axes, in rad.

    Without a lever they are displacements along the same axes in px; without stated axes along those of the
    sensor (x to the right, y upward).
    """

    def __init__(
        self, lever: Lever | None, axes: Axes, sensor_shape: tuple[int, int], shutter: Shutter = GLOBAL
    ) -> None:
        self._shutter = shutter
        self._rows = sensor_shape[0]
        self._lever = lever
        self._axes = axes
        self.unit = deflection_unit(lever)
        x_px, y_px = 0.5 * (sensor_shape[1] - 1), 0.5 * (sensor_shape[0] - 1)
        if lever is not None:
            x_px = x_px if lever.reference_x_px is None else lever.reference_x_px
            y_px = y_px if lever.reference_y_px is None else lever.reference_y_px
        self.reference_px = x_px, y_px
        """Position (x, y) of the spot at zero tilt."""

    def __call__(self, times_ns: NDArray[np.int64], spots: Sequence[Spot]) -> Deflections:
        """Deflections of the spots of frames at these times."""
        table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4)
        x_px, y_px, u_x_px, u_y_px = table.T
        times_ns = self._shutter.times_ns(times_ns, y_px, self._rows)
        spot_px = x_px, y_px, u_x_px, u_y_px
        if self._lever is None:
            values = displacements(self._axes, *spot_px, self.reference_px)
        else:
            values = deflections(self._lever, self._axes, *spot_px, self.reference_px)
        return Deflections(times_ns, *values, self.unit)


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
