"""What a run says of itself: to its record, to those who watch it, and as the state that this adds up to."""

import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from rich.console import ConsoleDimensions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from acquisition.record.events import EventKind
from acquisition.record.topics import (
    ESTIMATE,
    FITTED,
    HEALTH,
    LIGHT,
    PHASE,
    Environment,
    RecordedEstimate,
    RecordedHealth,
    RecordedLight,
    RecordedPhase,
    TimedMessage,
    TypedMessage,
)
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from rig.devices import Devices, LightWatch
from rig.instrument import ObserverGuard, Phase, RecordContents, RunNow
from rig.measure.posterior_worker import Posterior
from rig.presentation import loud, percent, quantity
from rig.settings import StopCondition

_HEALTH_NS = 1_000_000_000


class Watcher(Protocol):
    """Receives what the record of a run is told, for example the display.

    It is called in the processing thread, must return immediately and must not raise.
    """

    def take(self, told: RecordContents) -> None:
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
        self, watchers: Iterable[Watcher], devices: Devices | None, unit: DeflectionUnit, wall: ObserverGuard
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
        messages: list[TimedMessage] = [phase]
        if self._devices is not None:
            messages += [_light(self._devices), Environment(phase.time_ns, *self._devices.environment())]
        self.now = replace(
            self.now.after(RecordContents(messages=messages), self._unit), alarm=self.light.alarm
        )
        if phase.instruction and phase.instruction != instruction_before:
            self._instructions.append(self.now)

    def tell(self, told: RecordContents) -> None:
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
    ) -> list[TypedMessage]:
        """What the record is to be told of the session now: phase and light where they have changed, each
        new fit, and how the session keeps up once a second and where phase or alarm have changed.
        """
        time_ns, found = phase.time_ns, list[TypedMessage]()
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


_TWO_COLUMNS_FROM = 120
_MOST_NOTES = 10
_RATES_S = 5.0


def run_panel(
    title: str,
    now: RunNow,
    done: float,
    rows: Sequence[tuple[str, str]],
    notes: Sequence[str],
    size: ConsoleDimensions,
    phases: Sequence[Phase] = (),
) -> Panel:
    """A panel no wider and no higher than the terminal's `size`.

    `done` is the part of the run that is over, for the bar, `phases` are those before the record. Of `notes`
    as many of the last are shown as fit.
    """
    width, height = size
    table = Table.grid(padding=(0, 1))
    wide = width >= _TWO_COLUMNS_FROM
    for _ in range(4 if wide else 2):
        table.add_column(style="dim", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis")
    if wide:
        half = (len(rows) + 1) // 2
        left, right = rows[:half], [*rows[half:], ("", "")]
        for k in range(half):
            table.add_row(*left[k], *right[k])
    else:
        for row in rows:
            table.add_row(*row)
    parts: list[RenderableType] = [
        Text.assemble((f"{title}  ", "bold"), (now.doing, "bold cyan"), no_wrap=True),
        *([_strip(phases, now.phase)] if phases else []),
        _bar(done, width - 4),
        table,
    ]
    if now.alarm:
        parts.insert(0, Text(f"!!! {now.alarm.upper()} !!!", style="bold white on red"))
    if now.instruction:
        parts.append(Text(f">>> {loud(now.instruction)} <<<", style="bold reverse"))
    used = 4 + (len(rows) + 1) // 2 if wide else 4 + len(rows)
    used += bool(phases) + bool(now.instruction) + bool(now.alarm)
    room = max(1, min(_MOST_NOTES, height - used - 3))
    parts += [Text(note, style="dim", no_wrap=True, overflow="ellipsis") for note in notes[-room:]]
    return Panel(Group(*parts), width=width - 1, padding=(0, 1))


def _strip(phases: Sequence[Phase], now: Phase) -> Text:
    """All phases in their order, the present one marked."""
    shown = Text(no_wrap=True, overflow="ellipsis")
    for place, phase in enumerate((*phases, Phase.MEASURING)):
        shown.append(" > " if place else "", "dim")
        name = "recording" if phase is Phase.MEASURING else phase.value
        shown.append(name, "bold cyan" if phase is now else "dim")
    return shown


def _bar(part: float, width: int) -> Text:
    room = max(width - 8, 10)
    full = round(part * room)
    rest = ("━" * (room - full), "bright_black")
    return Text.assemble(("━" * full, "green"), rest, f" {100 * part:3.0f} %")


class Rates:
    """Frames and bytes per second over the last few seconds of the host's time."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque()

    def take(self, now: RunNow) -> None:
        """Note counts that have changed; fewer frames than before are those of a record that begins again."""
        points, now_s = self._points, time.monotonic()
        if points and now.frames < points[-1][1]:
            points.clear()
        if not points or now.frames != points[-1][1]:
            points.append((now_s, now.frames, now.record_bytes))
        while len(points) > 2 and now_s - points[0][0] > _RATES_S:
            points.popleft()

    @property
    def frames_hz(self) -> float:
        return self._rate(1)

    @property
    def bytes_per_s(self) -> float:
        return self._rate(2)

    def _rate(self, column: int) -> float:
        if len(self._points) < 2 or time.monotonic() - self._points[-1][0] > _RATES_S:
            return 0.0
        first, last = self._points[0], self._points[-1]
        return float(last[column] - first[column]) / max(last[0] - first[0], 1e-9)


_SHOWN_FROM = 1.0
"""Relative uncertainty below which a value means something."""


def estimate_rows(now: RunNow, stop_when: Sequence[StopCondition]) -> list[tuple[str, str]]:
    """Two parameters a row, and what the end of the run waits for; no row before the first fit."""
    found, keys = now.estimates, list(now.estimates)
    rows = [
        (
            ", ".join(quantity(key).symbol for key in pair),
            ",  ".join(_text(key, found[key]) for key in pair),
        )
        for pair in (keys[first : first + 2] for first in range(0, len(keys), 2))
    ]
    if stop_when:
        rows.append(("ends when", ", ".join(condition.text(found) for condition in stop_when)))
    return rows


def estimate_texts(key: str, one: Estimate) -> tuple[str, str]:
    """Value with its uncertainty in the parameter's shown unit, and how large the uncertainty is beside it.

    A value that its uncertainty hides is not shown.
    """
    relative = one.standard_uncertainty / abs(one.value) if one.value else float("inf")
    if not relative < _SHOWN_FROM:
        return "not yet seen", ""
    return quantity(key).text(one.value, one.standard_uncertainty), percent(relative)


def _text(key: str, one: Estimate) -> str:
    value, relative = estimate_texts(key, one)
    return f"{value} {quantity(key).unit}".rstrip() + f" ({relative})" if relative else value
