"""What a run says of itself: to its record, to those who watch it, and as the state that this adds up to."""

import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Protocol

from acquisition.record.events import EventKind
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
    RecordedPhase,
    Timed,
)
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from rig.devices import Devices, LightWatch
from rig.instrument import RunNow, Told, Wall
from rig.posterior import Posterior

_HEALTH_NS = 1_000_000_000


class Watcher(Protocol):
    """Receives what the record of a run is told, for example the display.

    It is called in the processing thread, must return immediately and must not raise.
    """

    def take(self, told: Told) -> None:
        """What the record has just been told."""


class RunStatus:
    """Written by the processing thread; `now` and `take_instructions` may be read from any other.

    Parameters
    ----------
    watchers
        Receive all that is told, in the processing thread.
    devices
        Controller, laser and environment sensor; None without devices.
    unit
        Unit of the swings' amplitudes.
    wall
        Behind which the watchers stand.
    """

    def __init__(
        self, watchers: Iterable[Watcher], devices: Devices | None, unit: DeflectionUnit, wall: Wall
    ) -> None:
        self._watchers = tuple(watchers)
        self._wall = wall
        self._devices = devices
        self._unit = unit
        self.light = LightWatch(devices)
        self._noticed: list[tuple[EventKind, str]] = []
        self._instructions: deque[RunNow] = deque()
        self.now = RunNow()
        self.begin_record()

    def begin_record(self) -> None:
        """Discard what belongs to the record of a rejected start."""
        self._phase: RecordedPhase | None = None
        self._light: RecordedLight | None = None
        self._estimates: Mapping[str, Estimate] = {}
        self._health_due_ns = 0
        self._alarm = ""
        self.now = self.now.begun_again()

    def take_instructions(self) -> Iterable[RunNow]:
        """States with an instruction to the operator since the last call, oldest first.

        They include short-lived instructions that a caller who only reads `now` could miss.
        """
        while self._instructions:
            yield self._instructions.popleft()

    def prepare(self, phase: RecordedPhase) -> None:
        """Tell a state before the record, which nothing records; looks at the laser."""
        self._noticed += self.light.look()
        instruction_before = self.now.instruction
        messages: list[Timed] = [phase]
        if self._devices is not None:
            messages += [_light(self._devices), Environment(phase.time_ns, *self._devices.environment())]
        self.now = replace(self.now.after(Told(messages=messages), self._unit), alarm=self.light.alarm)
        if phase.instruction and phase.instruction != instruction_before:
            self._instructions.append(self.now)

    def tell(self, told: Told) -> None:
        """Add what the record was told to the state, and pass it to the watchers."""
        self.now = self._wall.past("the state of the run", self.now, self.now.after, told, self._unit)
        for watcher in self._watchers:
            self._wall.past(f"watcher {type(watcher).__name__}", None, watcher.take, told)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of controller, laser and sensors since the last call, as (kind, text)."""
        happened = [] if self._devices is None else self._devices.take_events()
        happened += [(EventKind.WATCHER_FAILED, text) for text in self._wall.take_news()]
        noticed, self._noticed = self._noticed, []
        return happened + noticed + self.light.look()

    def messages(
        self, phase: RecordedPhase, health: RecordedHealth, known: Posterior, *, on_demand: bool
    ) -> list[Recorded]:
        """What the record is to be told of the session now: phase and light where they have changed, each
        new fit, and how the session keeps up once a second and where phase or alarm have changed.
        """
        time_ns, found = phase.time_ns, list[Recorded]()
        changed = self._phase is None or phase[2:] != self._phase[2:] or health.alarm != self._alarm
        if self._phase is None or phase[2:] != self._phase[2:]:
            found.append((PHASE, phase))
        self._phase, self._alarm = phase, health.alarm
        if self._devices is not None and (light := _light(self._devices)) != self._light:
            self._light = light
            found.append((LIGHT, light._replace(time_ns=time_ns)))
        if known.half_cycles and known.estimates is not self._estimates:
            self._estimates = known.estimates
            found += [
                (ESTIMATE, RecordedEstimate(time_ns, known.half_cycles, value, u, name))
                for name, (value, u) in known.estimates.items()
            ]
            found += [(FITTED, point._replace(time_ns=time_ns)) for point in known.points]
        now_ns = time_ns if on_demand else time.monotonic_ns()
        if changed or now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + _HEALTH_NS
            found.append((HEALTH, health))
        return found


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
