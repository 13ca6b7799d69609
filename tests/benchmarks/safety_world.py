"""A rig on a stepped clock, the program that has it, and an oracle that knows who has given leave.

Firmware's core, drivers, services, permit and latch are what runs in a session; threads are turned by hand.
The oracle is told what happens in the world, never what the program knows.
"""

import errno
import os
import random
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control import Controller, ControlService, LaserService, LightPermit, Stage, light_permit, make_laser
from rig.control.firmware.core import VERSION
from rig.control.lasers import serial_laser
from rig.control.serial_port import PortLost
from rig.devices import Devices
from rig.devices import laser as laser_module
from rig.devices.acknowledgement import LightWatch
from rig.settings import Configuration, validate_configuration
from tests.rig.control.instruments import Instrument
from tests.rig.control.lasers.pairs import FAMILIES
from tests.rig.control.stepped import Clock, InstrumentLine, SpoiledLine, SteppedBoard, stepped_clock, turn
from tests.rig.known_rig import known

PATHS = ("run", "balance", "align", "calibration", "preflight", "doctor", "resume")
WATCHDOG_S, STALL_S = 1.5, 5.0
DARK_WITHIN_S = {"off": 0.6, "cut": WATCHDOG_S + 0.6, "stall": STALL_S + 1.0}
"""What the light may take to go, by what took the leave away."""
FED_BY_BOARD = "controller"
HEARD_WITHIN_S = 0.6
BOARD_LATCHES = VERSION != "1.1"


class Oracle:
    """Who has given leave: a person who asked for light, since the last trip that a person acknowledged."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.asked = self.tripped = self.only_unseen = False
        self.watching = True
        self.since_s = 0.0
        self.why = "off"

    @property
    def leave(self) -> bool:
        return self.asked and not self.tripped

    def take(self, why: str, trip: bool, unseen: bool = False) -> None:
        """Leave ends: because of a trip, or because a person or the program ends the light.

        `unseen`: no program could see it, only a board that latches in the dark.
        """
        if trip:
            self.only_unseen = unseen and (self.only_unseen or not self.tripped)
        if self.leave:
            self.since_s, self.why = self._clock.monotonic(), why
        self.asked = False
        self.tripped = self.tripped or trip


class World:
    """A rig, the program that has it (or none), and people."""

    def __init__(self, seed: int, clock: Clock, kind: str = "", wired: bool | None = None) -> None:
        self.random, self.clock = random.Random(seed), clock
        self.oracle = Oracle(clock)
        self.board = Board(clock, self)
        self.kind = kind or self.random.choice([FED_BY_BOARD, FED_BY_BOARD, *FAMILIES])
        half = self.random.random() < 0.5
        self.wired = self.kind == FED_BY_BOARD or (half if wired is None else wired)
        self.instrument: Instrument | None = None
        if self.kind != FED_BY_BOARD:
            self.instrument = FAMILIES[self.kind][0]()
        self.config = self._configuration()
        self.program: Program | None = None
        self.was_lit = False
        self.opened_s = 0.0
        self.line = SpoiledLine(self.board)
        self.slow = self.full = False
        self._write = atomic_write.replace
        self.story: list[str] = []
        self.found: list[str] = []
        self.counts: Counter[str] = Counter()

    def _configuration(self) -> Configuration:
        laser: dict[str, Any] = {"kind": self.kind, "timeout_s": 0.1}
        if self.instrument is None:
            laser["power_w"] = 0.0005
        else:
            unit = "current_a" if self.kind in ("thorlabs4000", "ldc500") else "power_w"
            laser |= {"port": "instrument", unit: 0.02, f"max_{unit}": 0.03}
            laser["interlock"] = "controller" if self.wired else "own"
        controller = {"kind": "serial", "port": "stepped", "timeout_s": 0.1, "watchdog_s": WATCHDOG_S}
        return validate_configuration(
            {"camera": {"driver": "simulated"}, "laser": laser, "controller": controller}, "sequence"
        )

    def replace(self, path: Path, data: bytes, **named: int) -> None:
        """The disk of the rig's state, which may have no room left."""
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._write(path, data, **named)

    @property
    def quick(self) -> bool:
        """Whether an order to be dark takes no longer than usual."""
        program = self.program
        frozen = program is not None and program.frozen_to_s > self.clock.monotonic()
        return self.board.connected and not (self.slow or frozen)

    def open_laser(self, *_: object, **__: object) -> InstrumentLine:
        if self.instrument is None:
            raise PortLost("instrument: cannot open the serial port")
        return InstrumentLine(self.instrument, self.clock)

    @property
    def lit(self) -> bool:
        """Whether there is light, by what the world's own lamp shows."""
        enabled = self.board.shines
        if self.instrument is None:
            return enabled
        return self.instrument.on and (enabled or not self.wired)

    def look(self) -> None:
        """Hold the light against the leave."""
        if self.instrument is not None and self.wired:
            self.instrument.interlock_closed = self.board.shines
            self.instrument.light(self.instrument.on)
        lit, oracle = self.lit, self.oracle
        if lit and not self.was_lit:
            self.counts["lit"] += 1
            if not oracle.watching:
                pass
            elif not oracle.leave and oracle.only_unseen and not BOARD_LATCHES:
                self.counts["lit after an opening that no program saw"] += 1
                oracle.asked, oracle.tripped = True, False
            elif not oracle.leave:
                self.found.append("lit without leave")
        if lit and oracle.watching and not oracle.leave:
            late_s = self.clock.monotonic() - oracle.since_s - DARK_WITHIN_S[oracle.why]
            if late_s > 0 and not self.board.welded:
                self.found.append(f"still lit after {oracle.why}")
        self.was_lit = lit

    def live(self, duration_s: float) -> None:
        """Time passes for all."""
        end_s = self.clock.monotonic() + duration_s
        while (now_s := self.clock.monotonic()) < end_s and not self.found:
            if self.program is not None and self.program.frozen_to_s <= now_s:
                self.program.turn()
            self.board.turn(max(min(0.1, end_s - now_s), 0.005))
            self.look()


class Board(SteppedBoard):
    """Tells the oracle's lamp at each change, and can weld its relay."""

    def __init__(self, clock: Clock, world: World) -> None:
        self.world, self.welded, self._power_w = world, False, 0.0
        super().__init__(clock)
        # as a real one; it has been acknowledged since it got its power
        self.latches_at_start = True

    def set_laser(self, on: bool, power_w: float) -> None:
        super().set_laser(on, power_w)
        self._power_w = power_w if on else 0.0
        if hasattr(self.world, "was_lit"):
            self.world.look()

    def laser_enabled(self) -> bool:
        return super().laser_enabled() or self.welded

    @property
    def shines(self) -> bool:
        return self.laser_enabled()


class Program(Devices):
    """A program on one of the paths, whose threads are turned by hand."""

    def __init__(self, world: World, path: str) -> None:
        super().__init__(world.config, None, path)
        self.world, self.path = world, path
        self.permit = LightPermit(world.clock.monotonic, self.state, self._note_trip)
        self.frozen_to_s = 0.0
        self.stalled = False
        self.watch = LightWatch(self)
        self._due_s = [0.0, 0.0]

    def _open(self) -> None:
        config, board = self._config, self.world.board
        self._closing.enter_context(self.state)
        self._find_earlier_trips()
        controller = Controller(config.controller, config.laser.max_power_w, board.open_line)
        self.control = ControlService(controller, config.controller, None, self.permit)
        if turn(self.control) and self.control.snapshot.status is None:
            raise DeviceError("no controller")
        if self.world.instrument is not None:
            made = make_laser(config.laser)
            assert made is not None
            self.laser = LaserService(made, permit=self.permit, has_own_interlock=not self.world.wired)
            turn(self.laser)

    def turn(self, now: bool = False) -> None:
        """What its threads do as far as it is due, or `now`."""
        if not self.stalled:
            for stage in (Stage.CAMERA, Stage.PROCESSING):
                self.permit.note_progress(stage)
        self.obey_presses()
        now_s = self.world.clock.monotonic()
        for place, service in enumerate((self.control, self.laser)):
            if service is not None and (now or now_s >= self._due_s[place]):
                self._due_s[place] = now_s + turn(service)
        self.watch.look()

    def wait(self, command: Any, patience_s: float = 5.0) -> None:
        """As `wait_for_command`, with the threads turned meanwhile."""
        end_s = self.world.clock.monotonic() + patience_s
        while not command.done():
            if self.world.clock.monotonic() > end_s:
                raise DeviceError(f"a command was not carried out within {patience_s:g} s")
            for service in (self.control, self.laser):
                if service is not None:
                    turn(service)
            self.world.clock.sleep(0.005)
        command.result(0)

    def end(self, killed: bool) -> None:
        """Regularly, or without a word."""
        if not killed:
            self.permit.withdraw("the end")
            self.darken("the end")
            with suppress(DeviceError):
                self.turn()
            for service in (self.laser, self.control):
                if service is not None:
                    service._finish()
            with suppress(DeviceError):
                self.state.note_light(False)
        self._closing.close()


@contextmanager
def patched_wait(program: Program) -> Iterator[None]:
    with (
        patch.object(laser_module, "wait_for_command", program.wait),
        patch("rig.devices.lit_devices.wait_for_command", program.wait),
    ):
        yield


@contextmanager
def stepped_world(seed: int, folder: Path, kind: str = "", wired: bool | None = None) -> Iterator[World]:
    """A world whose host's code has the world's clock, lines and files."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        clock = stepped_clock(monkeypatch)
        monkeypatch.setenv("XDG_STATE_HOME", str(folder / str(seed)))
        monkeypatch.setattr("rig.control.safety_state._device_at", lambda _: "")
        world = World(seed, clock, kind, wired)
        for port in ("stepped", "instrument"):
            known(port)
        monkeypatch.setattr(serial_laser, "SerialPort", world.open_laser)
        monkeypatch.setattr(atomic_write, "replace", world.replace)
        # a full disk is no news here
        monkeypatch.setattr(light_permit._log, "disabled", True)
        for module in ("laser", "lit_devices"):
            monkeypatch.setattr(f"rig.devices.{module}.time", clock)
        yield world
        if world.program is not None:
            with suppress(Exception):
                world.program._closing.close()
