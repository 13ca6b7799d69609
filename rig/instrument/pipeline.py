"""The optics, and the pipeline from frames to spots, deflections and half-cycles, live and in replay."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Frame
from calibration import GLOBAL, Axes, Lever, Shutter, deflection_unit, deflections, displacements
from processing.balance import Balance, BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.spot import SensorModel, Spot, SpotTracker
from processing.swing import HalfCycle, TurningPointDetector
from rig.instrument.configured_camera import ObserverGuard, shutter_of
from rig.settings import Configuration

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
    half_cycles: Sequence[HalfCycle] = ()
    """Half-cycles that this block completes; they may have begun in earlier blocks."""
    balances: Sequence[Balance] = ()
    """Balances that this block completes."""
    references: Sequence[Spot] = ()
    """Spots of the reference, if there is one."""


class Pipeline:
    """Tracks the spot, computes deflections and detects half-cycles, frame by frame.

    The result depends only on the frames and their timestamps, not on their division into blocks. The
    pendulum's spot and the reference spot are tracked apart, each in its own part of the frames.

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
        self.tracker, self._reference_tracker = SpotTracker(optics.sensor), SpotTracker(optics.sensor)
        self.reference_row = optics.reference_row
        self.deflector = optics.deflector(sensor_shape)
        self._detector = TurningPointDetector()
        self._estimator = BalanceEstimator()
        self._guard = guard or ObserverGuard()
        self._thread = EstimateThread(self._estimates) if threaded else None
        self.estimate = self._estimates if self._thread is None else self._thread.update
        """Half-cycles and balances that further deflections complete."""

    def process(self, frames: Sequence[Frame], *, estimated: bool = True) -> Block:
        """Results of some consecutive frames; half-cycles and balances only if `estimated`."""
        row = self.reference_row
        times_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
        spots = [self.tracker.track(frame.image[:row]) for frame in frames]
        references: list[Spot] = []
        if row is not None and row < len(frames[0].image):
            track = self._reference_tracker.track
            below = [track(frame.image[row:]) for frame in frames]
            references = [spot._replace(y_px=spot.y_px + row) for spot in below]
        deflections = self.deflector(times_ns, spots)
        half_cycles, balances = self.estimate(deflections) if estimated else ([], [])
        return Block(spots, deflections, half_cycles, balances, references)

    def _estimates(self, samples: Deflections) -> Estimates:
        half_cycles = self._detector.update(samples.times_ns, samples.y, samples.u_y)
        balances: list[Balance] = self._guard.call(_BALANCE, [], self._estimator.update, samples)
        return half_cycles, balances

    def finish(self) -> Estimates:
        """Half-cycles that the end of the samples completes, and the estimates that are still being made."""
        half_cycles, balances = ([], []) if self._thread is None else self._thread.finish()
        return [*half_cycles, *self._detector.finish()], balances


def reference_px(lever: Lever | None, sensor_shape: tuple[int, int]) -> tuple[float, float]:
    """Position (x, y) of the spot at zero tilt: the lever's reference, else the sensor's middle."""
    rows, columns = sensor_shape
    x_px, y_px = (None, None) if lever is None else (lever.reference_x_px, lever.reference_y_px)
    return 0.5 * (columns - 1) if x_px is None else x_px, 0.5 * (rows - 1) if y_px is None else y_px


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

    def deflector(
        self, sensor_shape: tuple[int, int]
    ) -> Callable[[NDArray[np.int64], Sequence[Spot]], Deflections]:
        """The conversion of times and spots of frames to deflections, on a sensor of (ny, nx) pixels.

        Deflections are tilts along the pendulum's axes in rad. Without a lever they are displacements along
        the same axes in px; without stated axes along those of the sensor (x to the right, y upward).
        """
        return partial(self._deflections, reference_px(self.lever, sensor_shape), sensor_shape[0])

    def _deflections(
        self, zero_px: tuple[float, float], rows: int, times_ns: NDArray[np.int64], spots: Sequence[Spot]
    ) -> Deflections:
        table = np.array([spot[:4] for spot in spots], dtype=np.float64).reshape(-1, 4)
        x_px, y_px, u_x_px, u_y_px = table.T
        times_ns = self.shutter.times_ns(times_ns, y_px, rows)
        spot_px = x_px, y_px, u_x_px, u_y_px
        if self.lever is None:
            values = displacements(self.axes, *spot_px, zero_px)
        else:
            values = deflections(self.lever, self.axes, *spot_px, zero_px)
        return Deflections(times_ns, *values, self.unit)

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
