"""The status of a run as others see it: newest snapshot, events, readings of the environment."""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

from acquisition.frame import Frame
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import Environment
from processing.deflections import DeflectionUnit
from processing.swing import Swing
from rig.devices import Devices
from rig.instrument import Block, Snapshot
from rig.measure.run_parts import Watcher


class RunStatus:
    """Written by the processing thread; `snapshot` and `take_instructions` may be read from any other.

    Parameters
    ----------
    watchers
        Are told of every block, event and snapshot, in the processing thread.
    devices
        Controller, laser and environment sensor; None where there are none.
    unit
        Unit of the swings' amplitudes; snapshots hold them as they are shown.
    environment_period_s
        Time between two readings of the environment that are recorded.
    """

    def __init__(
        self,
        watchers: Iterable[Watcher],
        devices: Devices | None,
        unit: DeflectionUnit,
        environment_period_s: float,
    ) -> None:
        self._watchers = tuple(watchers)
        self._devices = devices
        self._unit = unit
        self._environment_period_ns = round(environment_period_s * 1e9)
        self._environment_due_ns = 0
        self._instructions: deque[Snapshot] = deque()
        self.snapshot = Snapshot()

    def take_instructions(self) -> Iterable[Snapshot]:
        """Snapshots with an instruction to the operator that were not taken yet, oldest first.

        An instruction that was given and withdrawn between two looks at `snapshot` is not missed.
        """
        while self._instructions:
            yield self._instructions.popleft()

    def begin_record(self) -> None:
        """Forget the half-cycles of a start that was not accepted."""
        self.snapshot = replace(self.snapshot, half_cycles=0, amplitude=math.nan, period_s=math.nan)

    def prepare(self, snapshot: Snapshot) -> None:
        """The state while no record is open, as the phases before it report it."""
        instruction_before = self.snapshot.instruction
        self.snapshot = self._with_devices(snapshot)
        if snapshot.instruction and snapshot.instruction != instruction_before:
            self._instructions.append(self.snapshot)
        for watcher in self._watchers:
            watcher.snapshot(self.snapshot)

    def publish(self, snapshot: Snapshot, swings: Sequence[Swing]) -> None:
        """The state while a record is open; amplitude and period of the last swing are filled in."""
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
        """A block with its events, and the state after it."""
        for watcher in self._watchers:
            watcher.block(start_ns, frames, block)
        self.tell_events(start_ns, events)
        for watcher in self._watchers:
            watcher.snapshot(self.snapshot)

    def tell_events(self, start_ns: int, events: Iterable[Event]) -> None:
        """Events alone."""
        for event in events:
            for watcher in self._watchers:
                watcher.event(start_ns, event)

    def take_events(self) -> list[tuple[EventKind, str]]:
        """(kind, text) of what controller, laser and sensors did since the last call."""
        return [] if self._devices is None else self._devices.take_events()

    def environment(self, time_ns: int) -> Environment | None:
        """A reading of the environment, once a period; None in between, and where nothing is measured."""
        if self._devices is None or time_ns < self._environment_due_ns:
            return None
        self._environment_due_ns = time_ns + self._environment_period_ns
        reading = self._devices.environment()
        return None if all(map(math.isnan, reading)) else Environment(time_ns, *reading)

    def _with_devices(self, snapshot: Snapshot) -> Snapshot:
        if self._devices is None:
            return snapshot
        temperature_c, humidity_percent, pressure_pa = self._devices.environment()
        return replace(
            snapshot,
            temperature_c=temperature_c,
            humidity_percent=humidity_percent,
            pressure_pa=pressure_pa,
            controller=self._devices.describe(),
        )
