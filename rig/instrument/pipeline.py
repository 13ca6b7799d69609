"""The optics, and the pipeline from frames to spots, deflections and swings, live and in replay."""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit, deflections, displacements
from processing.balance import Balance, BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.estimate import Estimate
from processing.spot import SensorModel, Spot, SpotTracker
from processing.swing import HalfCycle, TurningPointDetector
from rig.instrument.configured_camera import ObserverGuard, shutter_of
from rig.settings import Configuration

Found = TypeVar("Found")

_MOST_WAITING = 4096
_GATHERED_NS = 50_000_000
"""Samples that are handed to another thread together: at 1000 frames/s each frame would wake two threads."""
_BALANCE = "the estimate of the balance"


class BesideThread(Generic[Found]):
    """Calls `estimate` in a thread of its own, in order, and gives out its estimates when they are ready.

    Beside the frames, because one estimate takes as long as many of them. They are the same estimates as
    without the thread. `estimate` is the `update` of a detector or estimator, whose estimates do not depend
    on how the samples are divided; an error in it is raised by a later call. Only when thousands of calls
    wait does `update` wait too.
    """

    def __init__(self, estimate: Callable[[Deflections], list[Found]], name: str) -> None:
        self._estimate = estimate
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._gathered: list[Deflections] = []
        self._asked: deque[Future[list[Found]]] = deque()

    def update(self, samples: Deflections) -> list[Found]:
        """Add samples; returns the estimates that have become ready since the last call."""
        if len(samples):
            self._gathered.append(samples)
            if samples.times_ns[-1] - self._gathered[0].times_ns[0] >= _GATHERED_NS:
                self._hand_over()
        found: list[Found] = []
        while self._asked and (self._asked[0].done() or len(self._asked) > _MOST_WAITING):
            found += self._asked.popleft().result()
        return found

    def finish(self) -> list[Found]:
        """Wait for the estimates that are still being made, and return them."""
        self._hand_over()
        found = [one for asked in self._asked for one in asked.result()]
        self._asked.clear()
        return found

    def _hand_over(self) -> None:
        if self._gathered:
            samples, self._gathered = joined(self._gathered, self._gathered[0].unit), []
            self._asked.append(self._executor.submit(self._estimate, samples))


class Block(NamedTuple):
    """Results of some consecutive frames: one spot and one deflection per frame.

    `references` are the reference's spots, where the frames have one.
    `swings` and `balances` are those completed by this block; they may have begun in earlier blocks.
    """

    spots: list[Spot]
    deflections: Deflections
    swings: list[HalfCycle]
    balances: list[Balance]
    references: Sequence[Spot] = ()


class BothSpots:
    """Follows the pendulum's spot, and the reference's in the part of the frames that is its own.

    Parameters
    ----------
    tracker
        Follows the pendulum's spot.
    reference
        Follows the reference spot, and the row from which on the frames are its own.
    """

    def __init__(self, tracker: SpotTracker, reference: tuple[SpotTracker, int] | None) -> None:
        self.tracker = tracker
        self._reference = reference

    def in_frames(self, frames: Sequence[Frame]) -> tuple[list[Spot], list[Spot]]:
        """The spots of consecutive frames, and the reference's; none without one."""
        if self._reference is None:
            return [self.tracker.track(frame.image) for frame in frames], []
        tracker, row = self._reference
        spots = [self.tracker.track(frame.image[:row]) for frame in frames]
        seen = [tracker.track(frame.image[row:]) for frame in frames]
        return spots, [spot._replace(y_px=spot.y_px + row) for spot in seen]

    def tracked(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Of frames of a shape (ny, nx), that of the part in which the pendulum's spot is."""
        return shape if self._reference is None else (min(shape[0], self._reference[1]), shape[1])


class Pipeline:
    """Tracks the spot, computes deflections and detects swings, frame by frame.

    The result depends only on the frames and their timestamps, not on their division into blocks.

    Parameters
    ----------
    optics
        Calibration; each deflection gets the time of the rows that its spot lies on.
    sensor_shape
        (ny, nx) of the whole sensor; its centre is the reference if the lever states none.
    beside
        Fit the swings, and estimate the balance, in threads of their own. Their results are the same, but
        come with a later block than the one that completes them, the last ones with `finish` and
        `finish_balance`.
    wall
        Behind which the balance is estimated.
    """

    def __init__(
        self,
        optics: "Optics",
        sensor_shape: tuple[int, int],
        *,
        beside: bool = False,
        wall: ObserverGuard | None = None,
    ) -> None:
        self._spots = optics.both_spots()
        self.tracker = self._spots.tracker
        self._deflector = optics.deflector(sensor_shape)
        self._detector = TurningPointDetector()
        estimator = BalanceEstimator()
        self._swings = BesideThread(self._swings_in, "swings") if beside else None
        self._balances = BesideThread(estimator.update, "balance") if beside else None
        self._detect = self._swings_in if self._swings is None else self._swings.update
        self._balance = (self._balances or estimator).update
        self._wall = wall or ObserverGuard()

    def process(self, frames: Sequence[Frame]) -> Block:
        """Track the spot in some consecutive frames, and continue with `measure`."""
        times_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        spots, references = self._spots.in_frames(frames)
        return self.measure(times_ns, spots)._replace(references=references)

    def tracked(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Of frames of a shape (ny, nx), that of the part in which the pendulum's spot is."""
        return self._spots.tracked(shape)

    def measure(self, times_ns: NDArray[np.int64], spots: list[Spot]) -> Block:
        """Deflections, swings and balances from spots that were tracked before, in frames at these times."""
        return self.detect(spots, self._deflector(times_ns, spots))

    def detect(self, spots: list[Spot], deflections: Deflections) -> Block:
        """Swings and balances from known deflections (replay without tracking)."""
        swings = self._detect(deflections)
        balances: list[Balance] = self._wall.past(_BALANCE, [], self._balance, deflections)
        return Block(spots, deflections, swings, balances)

    def _swings_in(self, samples: Deflections) -> list[HalfCycle]:
        return self._detector.update(samples.times_ns, samples.y, samples.u_y)

    def finish(self) -> list[HalfCycle]:
        """Swings that are completed by the end of the samples."""
        waiting = [] if self._swings is None else self._swings.finish()
        return waiting + self._detector.finish()

    def finish_balance(self) -> list[Balance]:
        """Wait for the balances that are still being estimated, and return them."""
        return [] if self._balances is None else self._wall.past(_BALANCE, [], self._balances.finish)


class Deflector:
    """Converts spots to deflections: tilts along the pendulum's axes, in rad.

    Without a lever they are displacements along the same axes in px; where none are stated these are the
    sensor's (x to the right, y upward).
    `reference_px` is the position (x, y) of the spot at zero tilt, `unit` the unit of the deflections.
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
        """Deflections of spots measured in frames at these times."""
        table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4)
        x_px, y_px, u_x_px, u_y_px = table.T
        times_ns = self._shutter.times_ns(times_ns, y_px, self._rows)
        if self._lever is None:
            moved = displacements(self._axes, x_px, y_px, u_x_px, u_y_px, self.reference_px)
            return Deflections(times_ns, *moved, self.unit)
        tilts = deflections(self._lever, self._axes, x_px, y_px, u_x_px, u_y_px, self.reference_px)
        return Deflections(times_ns, *tilts, self.unit)


@dataclass(frozen=True, slots=True)
class Optics:
    """Calibrated values of the optical path; without a `lever` deflections are in px.

    From `reference_row` on the frames are the reference spot's.
    """

    sensor: SensorModel
    lever: Lever | None
    axes: Axes
    shutter: Shutter = GLOBAL
    reference_row: int | None = None
    reference_gain: Estimate | None = None
    """As it is stated."""

    def tracker(self) -> SpotTracker:
        """A new tracker."""
        return SpotTracker(self.sensor)

    def reference(self) -> tuple[SpotTracker, int] | None:
        """A new tracker of the reference's spot, and the row from which on frames are its own."""
        return None if self.reference_row is None else (self.tracker(), self.reference_row)

    def both_spots(self) -> BothSpots:
        """New trackers of the pendulum's spot and the reference's."""
        return BothSpots(self.tracker(), self.reference())

    def deflector(self, sensor_shape: tuple[int, int]) -> Deflector:
        """Converts spots to deflections, on a sensor of (ny, nx) pixels."""
        return Deflector(self.lever, self.axes, sensor_shape, self.shutter)

    def pipeline(
        self, sensor_shape: tuple[int, int], *, beside: bool = False, wall: ObserverGuard | None = None
    ) -> Pipeline:
        """A new pipeline from frames to deflections and half-cycles."""
        return Pipeline(self, sensor_shape, beside=beside, wall=wall)

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
