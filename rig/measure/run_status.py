"""The state of a run: as messages of its record, for its watchers, and its parameters in words."""

import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from acquisition.frames.queue import take_all
from acquisition.record.events import EventKind
from acquisition.record.topics import (
    Environment,
    RecordedEstimate,
    RecordedHealth,
    RecordedLight,
    RecordedPhase,
    TimedMessage,
)
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from rig.devices import Devices, LightWatch
from rig.instrument import ObserverGuard, RecordContents, RunNow
from rig.measure.posterior_worker import Posterior
from rig.settings import StopCondition
from rig.terminal import percent, quantity

_HEALTH_INTERVAL_NS = 1_000_000_000


class Watcher(Protocol):
    """Receives what is recorded of a run, for example the display.

    It is called in the processing thread, must return immediately and must not raise.
    """

    def take(self, recorded: RecordContents) -> None:
        """Receive what has just been recorded."""


class RunStatus:
    """The state of a run, written by the processing thread and passed to its watchers.

    `unit` is that of the half-cycles' amplitudes; `guard` catches the errors of watchers. `now` and
    `take_instructions` may be read from any thread.
    """

    def __init__(
        self, watchers: Iterable[Watcher], devices: Devices, unit: DeflectionUnit, guard: ObserverGuard
    ) -> None:
        self._watchers = tuple(watchers)
        self._guard = guard
        self._devices = devices
        self._unit = unit
        self.light = LightWatch(devices)
        self._light_events: list[tuple[EventKind, str]] = []
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
        self.now = self.now.for_new_record()

    def take_instructions(self) -> list[RunNow]:
        """States with an instruction to the operator since the last call, oldest first.

        Short-lived ones are among them, which `now` may never show to a caller.
        """
        return take_all(self._instructions)

    def prepare(self, phase: RecordedPhase) -> None:
        """Publish a state before the record begins, which is not recorded; looks at the laser."""
        self._light_events += self.light.look()
        last_instruction = self.now.instruction
        air = Environment(phase.time_ns, *self._devices.environment())
        messages: list[TimedMessage] = [phase, _recorded_light(self._devices), air]
        self.now = replace(
            self.now.with_contents(RecordContents(messages=messages), self._unit), alarm=self.light.alarm
        )
        if phase.instruction and phase.instruction != last_instruction:
            self._instructions.append(self.now)

    def tell(self, recorded: RecordContents) -> None:
        """Update the state by what was recorded, and pass that on to the watchers."""
        name, update = "the state of the run", self.now.with_contents
        self.now = self._guard.call(name, self.now, update, recorded, self._unit)
        for watcher in self._watchers:
            self._guard.call(f"watcher {type(watcher).__name__}", None, watcher.take, recorded)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """Events of controller, laser and sensors since the last call, as (kind, text)."""
        events = self._devices.take_events()
        events += [(EventKind.WATCHER_FAILED, text) for text in self._guard.take_news()]
        events += self._light_events + self.light.look()
        self._light_events = []
        return events

    def messages(
        self, phase: RecordedPhase, health: RecordedHealth, posterior: Posterior, *, on_demand: bool
    ) -> list[TimedMessage]:
        """Messages on the session that the record is due to get now.

        These are phase and light if they have changed, each new fit, and the health of the session once a
        second and whenever phase or alarm have changed.
        """
        time_ns, messages = phase.time_ns, list[TimedMessage]()
        # the first two fields are times
        is_new_phase = self._phase is None or phase[2:] != self._phase[2:]
        is_health_due = is_new_phase or health.alarm != self._alarm
        if is_new_phase:
            messages.append(phase)
        self._phase, self._alarm = phase, health.alarm
        if (light := _recorded_light(self._devices)) != self._light:
            self._light = light
            messages.append(light._replace(time_ns=time_ns))
        if posterior.half_cycles and posterior.estimates is not self._estimates:
            self._estimates = posterior.estimates
            messages += [
                RecordedEstimate(time_ns, posterior.half_cycles, value, u, name)
                for name, (value, u) in posterior.estimates.items()
            ]
            messages += [point._replace(time_ns=time_ns) for point in posterior.points]
        now_ns = time_ns if on_demand else time.monotonic_ns()
        if is_health_due or now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + _HEALTH_INTERVAL_NS
            messages.append(health)
        return messages


def _recorded_light(devices: Devices) -> RecordedLight:
    """The state of the light without ages, so that two are equal if nothing has changed."""
    safety = devices.safety()
    return RecordedLight(
        0,
        0 if safety.trip is None else safety.trip.number,
        -1 if safety.spot_visible is None else int(safety.spot_visible),
        safety.light.value,
        safety.interlock.value,
        devices.darkness(),
        safety.refusal,
        "" if safety.trip is None else safety.trip.text,
        safety.devices_text,
    )


def estimate_rows(now: RunNow, stop_when: Sequence[StopCondition]) -> list[tuple[str, str]]:
    """Rows of the panel for the parameters, two in each, and for the conditions that end the run.

    There are no parameters before the first fit.
    """
    estimates, keys = now.estimates, list(now.estimates)
    rows = [
        (
            ", ".join(quantity(key).symbol for key in pair),
            ",  ".join(_text(key, estimates[key]) for key in pair),
        )
        for pair in (keys[first : first + 2] for first in range(0, len(keys), 2))
    ]
    if stop_when:
        rows.append(("ends when", ", ".join(condition.text(estimates) for condition in stop_when)))
    return rows


def estimate_texts(key: str, estimate: Estimate) -> tuple[str, str]:
    """Texts of a parameter: value with uncertainty in its shown unit, and relative uncertainty in per cent.

    A value smaller than its uncertainty is not shown.
    """
    value, u = estimate
    if not u < abs(value):
        return "not yet seen", ""
    return quantity(key).text(value, u), percent(u / abs(value))


def _text(key: str, estimate: Estimate) -> str:
    value, relative = estimate_texts(key, estimate)
    return f"{value} {quantity(key).unit}".rstrip() + f" ({relative})" if relative else value
