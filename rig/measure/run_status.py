"""The status of a run for the display and watchers: snapshot, events, environment, losses."""

import math
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from acquisition.frame import Frame
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import (
    ESTIMATE,
    FITTED,
    HEALTH,
    LIGHT,
    PHASE,
    Recorded,
    RecordedEstimate,
    RecordedHealth,
    RecordedLight,
    RecordedPhase,
)
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.swing import Swing
from rig.devices import Devices, LightWatch
from rig.instrument import Block, Snapshot, Wall
from rig.measure.run_parts import Watcher

_HEALTH_NS = 1_000_000_000


class RunStatus:
    """Written by the processing thread; `snapshot` and `take_instructions` may be read from any other.

    Parameters
    ----------
    watchers
        Receive every block and event, in the processing thread.
    devices
        Controller, laser and environment sensor; None without devices.
    unit
        Unit of the swings' amplitudes; snapshots contain them in arcsec or px.
    wall
        Behind which the watchers stand.
    """

    def __init__(
        self,
        watchers: Iterable[Watcher],
        devices: Devices | None,
        unit: DeflectionUnit,
        wall: Wall,
    ) -> None:
        self._watchers = tuple(watchers)
        self._wall = wall
        self._devices = devices
        self.light = LightWatch(devices)
        self._noticed: list[tuple[EventKind, str]] = []
        self._unit = unit
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
        """Pass a block and its events to the watchers."""
        for watcher in self._watchers:
            self._wall.past(_name(watcher), None, watcher.block, start_ns, frames, block)
        self.tell_events(start_ns, events)

    def tell_events(self, start_ns: int, events: Iterable[Event]) -> None:
        """Pass events to the watchers."""
        for event in events:
            for watcher in self._watchers:
                self._wall.past(_name(watcher), None, watcher.event, start_ns, event)

    def end(self, snapshot: Snapshot) -> None:
        """Publish the state after the record, the last one."""
        self.snapshot = snapshot

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of controller, laser and sensors since the last call, as (kind, text)."""
        happened = [] if self._devices is None else self._devices.take_events()
        happened += [(EventKind.WATCHER_FAILED, text) for text in self._wall.take_news()]
        noticed, self._noticed = self._noticed, []
        return happened + noticed + self.light.look()

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
            found += [(FITTED, point._replace(time_ns=time_ns)) for point in state.fitted]
        now_ns = time_ns if on_demand else time.monotonic_ns()
        if now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + _HEALTH_NS
            found.append((HEALTH, _health(time_ns, state)))
        return found

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
