"""Readings and events that are recorded in addition to the frames: air, ground, clocks, losses, steps."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from acquisition.camera import Frame
from acquisition.frames.losses import FrameLosses
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import ClockAnchor, Environment, RecordedLosses, TimedMessage
from processing.deflections import DeflectionUnit
from processing.slope_uncertainty import KickWatch, StepWatch
from processing.spot import SpotFlag
from processing.units import nanoseconds
from rig.devices import ClockAnchors, ClockRate
from rig.instrument import Block, CameraClock
from rig.measure.run_parts import features_json

if TYPE_CHECKING:
    from rig.measure.run import MeasurementRun

_LOSSES_INTERVAL_NS = 1_000_000_000


class SideReadings:
    """Collects the readings that are recorded in addition to the frames.

    `clock` is the rate of the camera's clock against the computer's; unknown for frames made on demand, whose
    clock is not related to any other. `start_ns` is the time of the record's first frame.
    """

    def __init__(self, run: "MeasurementRun", start_ns: int) -> None:
        self._run, self._guard, self._start_ns = run, run.guard, start_ns
        on_demand = run.stream.policy == "wait"
        self._anchors = None if on_demand else ClockAnchors()
        self._rate = None if on_demand else ClockRate()
        self._environment_due_ns = self._losses_due_ns = 0
        self._recorded_losses = FrameLosses()
        self._has_air = False
        self.clock = CameraClock()

    def take(self, frames: Sequence[Frame]) -> tuple[list[TimedMessage], list[Event]]:
        """Messages and events to be recorded with these frames."""
        last, guard, seismometer = frames[-1], self._guard, self._run.devices.seismometer
        nothing: tuple[ClockAnchor | None, list[Event]] = (None, [])
        anchor, events = nothing
        if self._anchors is not None:
            anchor, events = guard.call(
                "the reading of the computer's clocks", nothing, self._anchors.take, last.time_ns
            )
        steps = [step for step in self._run.stream.take_clock_steps() if step.time_ns > self._start_ns]
        if self._rate is not None:
            self.clock = guard.call(
                "the reading of the camera's clock", self.clock, self._rate.take, frames, steps
            )
        readings = (self._environment(last.time_ns), self._losses(last.time_ns), anchor)
        samples = [] if seismometer is None else seismometer.take(last)
        messages: list[TimedMessage] = [
            *(reading for reading in readings if reading is not None),
            *steps,
            *(sample for sample in samples if sample.time_ns >= self._start_ns),
        ]
        return messages, events

    def end_attachments(self) -> dict[str, bytes]:
        """The attachments for the end of the record, by name."""
        camera = self._run.camera.camera
        features = self._guard.call("the reading of the camera's features", b"", features_json, camera)
        return {"camera-features-end.json": features} if features else {}

    def _losses(self, time_ns: int) -> RecordedLosses | None:
        """The losses since the record began, if they have changed; at most once per second of frame time."""
        losses = self._run.stream.losses
        if losses == self._recorded_losses or time_ns < self._losses_due_ns:
            return None
        self._losses_due_ns, self._recorded_losses = time_ns + _LOSSES_INTERVAL_NS, losses
        return RecordedLosses(time_ns, *losses.counts)

    def _environment(self, time_ns: int) -> Environment | None:
        """A reading of the environment, once per period; None in between and without a sensor. A sensor that
        has fallen silent is recorded once, as a reading of NaN."""
        devices = self._run.devices
        if time_ns < self._environment_due_ns:
            return None
        self._environment_due_ns = time_ns + nanoseconds(self._run.plan.config.environment_sensor.period_s)
        reading = devices.environment()
        had_air, self._has_air = self._has_air, not all(map(math.isnan, reading))
        return Environment(time_ns, *reading) if had_air or self._has_air else None


_MIN_REST_STEP = {DeflectionUnit.RAD: 3.0, DeflectionUnit.PX: 1.0}
"""Smallest step of the rest position that is an event, in arcsec, or in px without a lever: far above the
drift within some half-cycles."""
_MIN_PUSH = {DeflectionUnit.RAD: 1.0, DeflectionUnit.PX: 2.0}
"""Smallest sudden change of the amplitude that is an event, in arcsec, or in px without a lever."""
_MIN_LIGHT_STEP_DN = 1.0


class StepEvents:
    """Detects steps of rest position, amplitude and background in a run.

    Only one value of each half-cycle is compared, so that the oscillation itself cancels.
    """

    def __init__(self, unit: DeflectionUnit) -> None:
        self._unit = unit
        self._rest_watch = StepWatch(_MIN_REST_STEP[unit])
        self._push_watch = KickWatch(_MIN_PUSH[unit])
        self._light_watch = StepWatch(_MIN_LIGHT_STEP_DN)
        self._background_dn: list[float] = []

    def take(self, block: Block) -> list[Event]:
        """Events of the steps detected with this block."""
        events: list[Event] = []
        lost = SpotFlag.LOST
        self._background_dn += [spot.background_dn for spot in block.spots if not spot.flags & lost]
        for half_cycle in block.half_cycles:
            time_ns, rest, amplitude = half_cycle.turn_time_ns, math.nan, math.nan
            if not half_cycle.flags:
                rest = half_cycle.centre / self._unit.shown_size
                amplitude = half_cycle.amplitude / self._unit.shown_size
            if (step := self._rest_watch.take(time_ns, rest)) is not None:
                text = f"the rest position moved by {step.size:+.1f} {self._unit.shown}"
                events.append(Event(step.time_ns, EventKind.REST_STEP, text))
            if (kick := self._push_watch.take(half_cycle.index, time_ns, amplitude)) is not None:
                text = f"the swing was pushed by {kick.size:.1f} {self._unit.shown}: a draught, or a knock"
                events.append(Event(kick.time_ns, EventKind.PUSH, text))
            light_dn = float(np.median(self._background_dn)) if self._background_dn else math.nan
            self._background_dn.clear()
            if (step := self._light_watch.take(time_ns, light_dn)) is not None:
                text = f"the background moved by {step.size:+.1f} DN"
                events.append(Event(step.time_ns, EventKind.LIGHT_STEP, text))
        return events
