"""What a record gets beside the frames: air, ground, clocks, losses, the camera's temperature."""

import math
import threading
from collections.abc import Sequence
from dataclasses import astuple
from typing import Final

from acquisition.camera import Camera, Frame, HasFeatures
from acquisition.frames.losses import FrameLosses
from acquisition.record.events import Event
from acquisition.record.topics import (
    CAMERA_STEP,
    CAMERA_TEMPERATURE,
    CLOCK,
    ENVIRONMENT,
    LOSSES,
    WITNESS,
    CameraTemperature,
    ClockAnchor,
    Environment,
    RecordedLosses,
    RecordedWitness,
    TypedMessage,
)
from processing.errors import DeviceError
from processing.units import nanoseconds
from rig.devices import ClockAnchors, ClockRate, FrameStream
from rig.instrument import CameraClock
from rig.measure.run_parts import RunParts, features_json

_LOSSES_NS = 1_000_000_000
_TEMPERATURE = "the camera's temperature"
_TEMPERATURES: Final = ("DeviceTemperature", "TemperatureAbs")
"""Features with the temperature inside the camera in degrees Celsius, by what different makers call it."""


class TemperatureWatch:
    """Reads the camera's temperature every `period_s`, in a thread, because a camera may answer late.

    A camera that does not say its temperature is asked once.
    """

    def __init__(self, camera: Camera, period_s: float = 10.0) -> None:
        self._camera = camera
        self._period_s = period_s
        self._ended = threading.Event()
        self._reading: float | None = None
        self._thread = threading.Thread(target=self._watch, name="camera temperature", daemon=True)
        self._thread.start()

    def take(self, time_ns: int) -> CameraTemperature | None:
        """The reading since the last call, if there is one; never blocks."""
        reading, self._reading = self._reading, None
        return None if reading is None else CameraTemperature(time_ns, reading)

    def close(self) -> None:
        """Read no more; does not wait for a reading that is under way."""
        self._ended.set()

    def _watch(self) -> None:
        names = self._read(_TEMPERATURES)
        while names and not self._ended.wait(self._period_s):
            names = self._read(names)

    def _read(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Read the first of these features that the camera has; returns those to read the next time."""
        if not isinstance(self._camera, HasFeatures):
            return ()
        for name in names:
            try:
                value = self._camera.feature_value(name)
            except DeviceError:
                return names  # unplugged, perhaps for a while
            if value is not None:
                self._reading = float(value)
                return (name,)
        return ()


class LossLog:
    """Losses of a stream since a record began; with `from_start` also those before the record."""

    def __init__(self, stream: FrameStream, *, from_start: bool) -> None:
        self._stream = stream
        self._before = FrameLosses() if from_start else stream.losses
        self._written = FrameLosses()
        self._due_ns = 0

    @property
    def now(self) -> FrameLosses:
        """Losses so far."""
        return self._stream.losses.since(self._before)

    def due(self, time_ns: int) -> RecordedLosses | None:
        """The losses to be recorded now, if they have changed; at most once per second of frame time."""
        now = self.now
        if now == self._written or time_ns < self._due_ns:
            return None
        self._due_ns = time_ns + _LOSSES_NS
        return self.last(time_ns)

    def last(self, time_ns: int) -> RecordedLosses:
        """The present losses, to be recorded in any case."""
        self._written = self.now
        return RecordedLosses(time_ns, *astuple(self._written))


class SideReadings:
    """What a record gets beside the frames: air, ground, clocks, losses, the camera's temperature.

    `clock` is the camera's against the computer's. Frames made on demand have a clock of their own, of which
    no other one says anything.
    """

    def __init__(self, parts: RunParts, losses: LossLog, start_ns: int) -> None:
        self._parts, self._losses, self._wall, self._start_ns = parts, losses, parts.wall, start_ns
        on_demand = parts.stream.policy == "wait"
        self._anchors = None if on_demand else ClockAnchors()
        self._rate = None if on_demand else ClockRate()
        self._temperature = TemperatureWatch(parts.camera.camera)
        self._environment_due_ns = 0
        self._has_air = False
        self.clock = CameraClock()

    def take(self, frames: Sequence[Frame]) -> tuple[list[TypedMessage], list[Event]]:
        """What is to be recorded with these frames, and events."""
        last, wall = frames[-1], self._wall
        nothing: tuple[ClockAnchor | None, list[Event]] = (None, [])
        anchor, events = nothing
        if self._anchors is not None:
            anchor, events = wall.past(
                "the reading of the computer's clocks", nothing, self._anchors.take, last.time_ns
            )
        steps = [one for one in self._parts.stream.take_clock_steps() if one.time_ns > self._start_ns]
        if self._rate is not None:
            self.clock = wall.past(
                "the reading of the camera's clock", self.clock, self._rate.take, frames, steps
            )
        warmth = wall.past(_TEMPERATURE, None, self._temperature.take, last.time_ns)
        once = (
            (ENVIRONMENT, self._environment(last.time_ns)),
            (LOSSES, self._losses.due(last.time_ns)),
            (CLOCK, anchor),
            (CAMERA_TEMPERATURE, warmth),
        )
        found: list[TypedMessage] = [
            *((kind, value) for kind, value in once if value is not None),
            *((CAMERA_STEP, step) for step in steps),
            *((WITNESS, one) for one in self._witness(last) if one.time_ns >= self._start_ns),
        ]
        return found, events

    def close(self) -> dict[str, bytes]:
        """Read no more; returns what is attached at the end."""
        camera = self._parts.camera.camera
        self._wall.past(_TEMPERATURE, None, self._temperature.close)
        features = self._wall.past("the reading of the camera's features", b"", features_json, camera)
        return {"camera-features-end.json": features} if features else {}

    def _environment(self, time_ns: int) -> Environment | None:
        """A reading of the environment, once per period; None in between and without a sensor.

        That a sensor says nothing any more is recorded once, as a reading of nothing.
        """
        devices = self._parts.devices
        if devices is None or time_ns < self._environment_due_ns:
            return None
        self._environment_due_ns = time_ns + nanoseconds(self._parts.plan.config.environment_sensor.period_s)
        reading = devices.environment()
        before, self._has_air = self._has_air, not all(map(math.isnan, reading))
        return Environment(time_ns, *reading) if before or self._has_air else None

    def _witness(self, frame: Frame) -> list[RecordedWitness]:
        """Samples of the witness of the ground since the last call, up to a frame; none without one."""
        devices = self._parts.devices
        return [] if devices is None or devices.witness is None else devices.witness.take(frame)
