"""The status of a run for the display and watchers: snapshot, events, environment, losses."""

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, replace

from acquisition.frame import Frame
from acquisition.frames.losses import FrameLosses
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import (
    ESTIMATE,
    FITTED,
    HEALTH,
    LIGHT,
    PHASE,
    Environment,
    Recorded,
    RecordedEstimate,
    RecordedHealth,
    RecordedLight,
    RecordedLosses,
    RecordedPhase,
    RecordedWitness,
)
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.swing import Swing
from processing.ticks import nanoseconds
from rig.devices import Devices, FrameStream, LightWatch
from rig.instrument import Block, Snapshot, Wall
from rig.measure.run_parts import Watcher


class RunStatus:
    """Written by the processing thread; `snapshot` and `take_instructions` may be read from any other.

    Parameters
    ----------
    watchers
        Receive every block, event and snapshot, in the processing thread.
    devices
        Controller, laser and environment sensor; None without devices.
    unit
        Unit of the swings' amplitudes; snapshots contain them in arcsec or px.
    environment_period_s
        Time between two recorded readings of the environment.
    wall
        Behind which the watchers stand.
    """

    def __init__(
        self,
        watchers: Iterable[Watcher],
        devices: Devices | None,
        unit: DeflectionUnit,
        environment_period_s: float,
        wall: Wall,
    ) -> None:
        self._watchers = tuple(watchers)
        self._wall = wall
        self._devices = devices
        self.light = LightWatch(devices)
        self._noticed: list[tuple[EventKind, str]] = []
        self._unit = unit
        self._environment_period_ns = nanoseconds(environment_period_s)
        self._environment_due_ns = 0
        self._instructions: deque[Snapshot] = deque()
        self.snapshot = Snapshot()
        self._begin()

    def _begin(self) -> None:
        self._phase: RecordedPhase | None = None
        self._light: RecordedLight | None = None
        self._estimates: Mapping[str, Estimate] = {}
        self._health_due_ns = 0

    def take_instructions(self) -> Iterable[Snapshot]:
        """Snapshots with an instruction to the operator since the last call, oldest first.

        They include short-lived instructions that a caller who only reads `snapshot` could miss.
        """
        while self._instructions:
            yield self._instructions.popleft()

    def begin_record(self) -> None:
        """Discard what belongs to the record of a rejected start."""
        self._begin()
        self.snapshot = replace(self.snapshot, half_cycles=0, amplitude=math.nan, period_s=math.nan)

    def prepare(self, snapshot: Snapshot) -> None:
        """Publish the state before the record, as reported by the phases; looks at the laser."""
        self._noticed += self.light.look()
        instruction_before = self.snapshot.instruction
        self.snapshot = self._with_devices(snapshot)
        if snapshot.instruction and snapshot.instruction != instruction_before:
            self._instructions.append(self.snapshot)
        self._show(self.snapshot)

    def publish(self, snapshot: Snapshot, swings: Sequence[Swing]) -> None:
        """Publish the state during the record, with amplitude and period of the last swing."""
        before, last = self.snapshot, swings[-1] if swings else None
        amplitude, period_s = before.amplitude, before.period_s
        if last is not None:
            amplitude = last.amplitude / self._unit.shown_size
            period_s = before.period_s if math.isnan(last.half_period_s) else 2.0 * last.half_period_s
        self.snapshot = self._with_devices(
            replace(
                snapshot,
                half_cycles=before.half_cycles + len(swings),
                amplitude=amplitude,
                period_s=period_s,
            )
        )

    def tell(self, start_ns: int, frames: Sequence[Frame], block: Block, events: Iterable[Event]) -> None:
        """Pass a block, its events and the state after it to the watchers."""
        for watcher in self._watchers:
            self._wall.past(_name(watcher), None, watcher.block, start_ns, frames, block)
        self.tell_events(start_ns, events)
        self._show(self.snapshot)

    def tell_events(self, start_ns: int, events: Iterable[Event]) -> None:
        """Pass events to the watchers."""
        for event in events:
            for watcher in self._watchers:
                self._wall.past(_name(watcher), None, watcher.event, start_ns, event)

    def end(self, snapshot: Snapshot) -> None:
        """Publish the state after the record, the last one, to the watchers too."""
        self.snapshot = snapshot
        self._show(snapshot)

    def _show(self, snapshot: Snapshot) -> None:
        for watcher in self._watchers:
            self._wall.past(_name(watcher), None, watcher.snapshot, snapshot)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of controller, laser and sensors since the last call, as (kind, text)."""
        happened = [] if self._devices is None else self._devices.take_events()
        happened += [(EventKind.WATCHER_FAILED, text) for text in self._wall.take_news()]
        noticed, self._noticed = self._noticed, []
        return happened + noticed + self.light.look()

    def environment(self, time_ns: int) -> Environment | None:
        """A reading of the environment, once per period; None in between and without a sensor."""
        if self._devices is None or time_ns < self._environment_due_ns:
            return None
        self._environment_due_ns = time_ns + self._environment_period_ns
        reading = self._devices.environment()
        return None if all(map(math.isnan, reading)) else Environment(time_ns, *reading)

    def messages(self, time_ns: int, *, on_demand: bool = False) -> list[Recorded]:
        """What the record is to say of the session now: phase and light where they have changed, each new
        fit, and once a second how the session keeps up.
        """
        state, found = self.snapshot, list[Recorded]()
        phase = RecordedPhase(0, 0.0, state.phase.value, state.progress, state.instruction, state.reason)
        if phase != self._phase:
            self._phase = phase
            found.append((PHASE, phase._replace(time_ns=time_ns, elapsed_s=state.elapsed_s)))
        if self._devices is not None and (light := _light(self._devices)) != self._light:
            self._light = light
            found.append((LIGHT, light._replace(time_ns=time_ns)))
        if state.estimated_from and state.estimates is not self._estimates:
            self._estimates = state.estimates
            found += [
                (ESTIMATE, RecordedEstimate(time_ns, state.estimated_from, value, u, name))
                for name, (value, u) in state.estimates.items()
            ]
            if state.decay is not None:
                found += [(FITTED, point) for point in state.decay.points(time_ns)]
        now_ns = time_ns if on_demand else time.monotonic_ns()
        if now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + _INTERVAL_NS
            found.append((HEALTH, _health(time_ns, state)))
        return found

    def witness(self, frame: Frame) -> list[RecordedWitness]:
        """Samples of the witness of the ground since the last call, up to a frame; none without one."""
        if self._devices is None or self._devices.witness is None:
            return []
        return self._devices.witness.take(frame)

    def _with_devices(self, snapshot: Snapshot) -> Snapshot:
        if self._devices is None:
            return snapshot
        temperature_c, humidity_percent, pressure_pa = self._devices.environment()
        return replace(
            snapshot,
            temperature_c=temperature_c,
            humidity_percent=humidity_percent,
            pressure_pa=pressure_pa,
            devices=self._devices.now(),
            alarm=self.light.alarm or snapshot.alarm,
        )


def _light(devices: Devices) -> RecordedLight:
    """Without ages, so that two are equal where nothing has changed."""
    safety = devices.safety()
    return RecordedLight(
        0,
        0 if safety.trip is None else safety.trip.number,
        -1 if safety.seen is None else int(safety.seen),
        safety.light.value,
        safety.interlock.value,
        devices.darkness(),
        safety.refusal,
        "" if safety.trip is None else safety.trip.text,
        devices.now().text,
    )


def _health(time_ns: int, state: Snapshot) -> RecordedHealth:
    return RecordedHealth(
        time_ns,
        state.frames,
        state.dropped_frames,
        state.lost_spots,
        state.half_cycles,
        state.queue_frames,
        state.record_bytes,
        state.frame_age_s,
        state.disk_free_bytes,
        state.disk_silent_s,
        state.clock.drift_ppm,
        state.clock.u_drift_ppm,
        state.alarm,
        state.beam,
    )


def _name(watcher: Watcher) -> str:
    return f"watcher {type(watcher).__name__}"


_INTERVAL_NS = 1_000_000_000


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
        self._due_ns = time_ns + _INTERVAL_NS
        return self.last(time_ns)

    def last(self, time_ns: int) -> RecordedLosses:
        """The present losses, to be recorded in any case."""
        self._written = self.now
        return RecordedLosses(time_ns, *astuple(self._written))
