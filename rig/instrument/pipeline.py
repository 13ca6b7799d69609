"""The optics, and the pipeline from frames to spots, deflections and half-cycles, live and in replay."""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from acquisition.record.writer import RecordWriter
from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit, deflections, displacements
from processing.balance import Balance, BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.estimate import Estimate
from processing.spot import SensorModel, Spot, SpotTracker
from processing.swing import HalfCycle, TurningPointDetector
from rig.instrument.configured_camera import ObserverGuard, shutter_of
from rig.settings import Configuration

Result = TypeVar("Result")

_MAX_WAITING_CALLS = 4096
_BATCH_NS = 50_000_000
"""Time span of samples that are handed to a thread together: at 1000 frames/s each frame would wake two."""
_BALANCE = "the estimate of the balance"


class EstimateThread(Generic[Result]):
    """A thread that calls `estimate` on batches of samples in order, so that frames do not wait for it.

    One estimate takes as long as many frames. The estimates are the same as without the thread: `estimate` is
    the `update` of a detector or estimator, which does not depend on how samples are divided. An error in it
    is raised by a later call. `update` waits only while thousands of calls are pending.
    """

    def __init__(self, estimate: Callable[[Deflections], list[Result]], name: str) -> None:
        self._estimate = estimate
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._batch: list[Deflections] = []
        self._pending: deque[Future[list[Result]]] = deque()

    def update(self, samples: Deflections) -> list[Result]:
        """Add samples; returns the estimates that have become ready since the last call."""
        if len(samples):
            self._batch.append(samples)
            if samples.times_ns[-1] - self._batch[0].times_ns[0] >= _BATCH_NS:
                self._hand_over()
        estimates: list[Result] = []
        while self._pending and (self._pending[0].done() or len(self._pending) > _MAX_WAITING_CALLS):
            estimates += self._pending.popleft().result()
        return estimates

    def finish(self) -> list[Result]:
        """Wait for the estimates that are still being made, and return them."""
        self._hand_over()
        estimates = [estimate for pending in self._pending for estimate in pending.result()]
        self._pending.clear()
        return estimates

    def _hand_over(self) -> None:
        if self._batch:
            samples, self._batch = joined(self._batch, self._batch[0].unit), []
            self._pending.append(self._executor.submit(self._estimate, samples))


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

    Parameters
    ----------
    tracker
        The tracker of the pendulum's spot.
    reference
        The tracker of the reference spot, and the first row of its part of the frames; None without one.
    """

    def __init__(self, tracker: SpotTracker, reference: tuple[SpotTracker, int] | None) -> None:
        self.tracker = tracker
        self._reference = reference

    def track(self, frames: Sequence[Frame]) -> tuple[list[Spot], list[Spot]]:
        """The pendulum's spots in consecutive frames, and the reference spots, empty without a reference."""
        if self._reference is None:
            return [self.tracker.track(frame.image) for frame in frames], []
        tracker, first_row = self._reference
        spots = [self.tracker.track(frame.image[:first_row]) for frame in frames]
        references = [tracker.track(frame.image[first_row:]) for frame in frames]
        return spots, [spot._replace(y_px=spot.y_px + first_row) for spot in references]

    def pendulum_shape(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Shape (ny, nx) of the part of a frame of this shape that contains the pendulum's spot."""
        return shape if self._reference is None else (min(shape[0], self._reference[1]), shape[1])


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
        Whether half-cycles are fitted, and the balance is estimated, in threads of their own. The results are
        the same, but come with a later block, the last ones with `finish` and `finish_balance`.
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
        estimator = BalanceEstimator()
        self._half_cycles = EstimateThread(self._half_cycles_in, "swings") if threaded else None
        self._balances = EstimateThread(estimator.update, "balance") if threaded else None
        self._detect = self._half_cycles_in if self._half_cycles is None else self._half_cycles.update
        self._balance = (self._balances or estimator).update
        self._guard = guard or ObserverGuard()

    def process(self, frames: Sequence[Frame]) -> Block:
        """Track the spot in some consecutive frames, and continue with `measure`."""
        times_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        spots, references = self.spots.track(frames)
        return self.measure(times_ns, spots)._replace(references=references)

    def measure(self, times_ns: NDArray[np.int64], spots: list[Spot]) -> Block:
        """Deflections, half-cycles and balances from spots of frames at these times."""
        return self.detect(spots, self._deflector(times_ns, spots))

    def detect(self, spots: list[Spot], deflections: Deflections) -> Block:
        """Half-cycles and balances from known deflections (replay without tracking)."""
        half_cycles = self._detect(deflections)
        balances: list[Balance] = self._guard.call(_BALANCE, [], self._balance, deflections)
        return Block(spots, deflections, half_cycles, balances)

    def _half_cycles_in(self, samples: Deflections) -> list[HalfCycle]:
        return self._detector.update(samples.times_ns, samples.y, samples.u_y)

    def finish(self) -> list[HalfCycle]:
        """Half-cycles that are completed by the end of the samples."""
        pending = [] if self._half_cycles is None else self._half_cycles.finish()
        return pending + self._detector.finish()

    def finish_balance(self) -> list[Balance]:
        """Wait for the balances that are still being estimated, and return them."""
        return [] if self._balances is None else self._guard.call(_BALANCE, [], self._balances.finish)


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
    reference_gain: Estimate | None = None
    """Gain of the reference's correction as stated; None if a fit determines it."""

    def tracker(self) -> SpotTracker:
        """A new tracker."""
        return SpotTracker(self.sensor)

    def reference(self) -> tuple[SpotTracker, int] | None:
        """A new tracker of the reference spot, and the first row of its part of the frames."""
        return None if self.reference_row is None else (self.tracker(), self.reference_row)

    def dual_tracker(self) -> DualSpotTracker:
        """New trackers of the pendulum's spot and the reference spot."""
        return DualSpotTracker(self.tracker(), self.reference())

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
        None
        if config.reference is None or config.reference.gain is None
        else Estimate(config.reference.gain, config.reference.u_gain),
    )


def sensor_model(config: Configuration, full_scale_dn: float) -> SensorModel:
    """Noise model of the sensor for the tracker.

    Without [sensor] a full well of 10 000 electrons is assumed, typical of small CMOS sensors; the
    tracker increases its uncertainties if the chi2 of its fit shows that they are too small.
    """
    if config.sensor is not None:
        return config.sensor
    return SensorModel(gain_e_per_dn=10_000.0 / full_scale_dn, read_noise_e=7.0, full_scale_dn=full_scale_dn)
