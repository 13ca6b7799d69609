"""Random sequences of faults, keys and commands on a stepped clock, and an oracle that knows who gave leave.

Firmware's core, drivers, services, permit, latch and orders are what runs in a session; threads are turned
by hand. The oracle is told what happens in the world, never what the program knows.
"""

import os
import random
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from processing.errors import DeviceError, RigError
from rig.control import Controller, ControlService, LaserService, LightPermit, Stage, TripCause, make_laser
from rig.control.firmware.core import VERSION
from rig.control.lasers import serial_laser
from rig.control.serial_port import PortLost
from rig.devices import Devices, leave
from rig.devices import laser as laser_module
from rig.devices.light_watch import LightWatch
from rig.measure import session_orders
from rig.settings import Configuration, validate_configuration
from tests.rig.control.instruments import Instrument
from tests.rig.control.stepped import Clock, InstrumentLine, SteppedBoard, stepped_clock, turn
from tests.rig.control.test_lasers import FAMILIES, STRAYED

PATHS = ("run", "plan", "balance", "align", "calibration", "preflight", "doctor", "resume")
WATCHDOG_S, STALL_S = 1.5, 5.0
DARK_WITHIN_S = {"off": 0.6, "cut": WATCHDOG_S + 0.6, "stall": STALL_S + 1.0}
"""What the light may take to go, by what took the leave away."""
TYPED = ("", "a", "y", "s", "glass ball", "light", "acknowledge", "0", "999")
FED_BY_BOARD = "controller"
HEARD_WITHIN_S = 0.6
BOARD_LATCHES = VERSION != "1.1"


class Oracle:
    """Who has given leave: a person who asked for light, since the last trip that a person acknowledged."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.asked = self.tripped = self.only_unseen = False
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

    def __init__(self, seed: int, clock: Clock, folder: Path) -> None:
        self.random, self.clock = random.Random(seed), clock
        self.oracle = Oracle(clock)
        self.board = Board(clock, self)
        self.kind = self.random.choice([FED_BY_BOARD, FED_BY_BOARD, *FAMILIES])
        self.wired = self.kind == FED_BY_BOARD or self.random.random() < 0.5
        self.instrument: Instrument | None = None
        if self.kind != FED_BY_BOARD:
            self.instrument = FAMILIES[self.kind][0]()
        self.config = self._configuration()
        self.program: Program | None = None
        self.was_lit = False
        self.opened_s = 0.0
        self.story: list[str] = []
        self.found: list[str] = []
        self.counts: Counter[str] = Counter()
        self.folder = folder

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
            if not oracle.leave and oracle.only_unseen and not BOARD_LATCHES:
                self.counts["lit after an opening that no program saw"] += 1
                oracle.asked, oracle.tripped = True, False
            elif not oracle.leave:
                self.found.append("lit without leave")
        if lit and not oracle.leave:
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
        self.permit = LightPermit(world.clock.monotonic, self.state, self._tripped)
        self.frozen_to_s = 0.0
        self.stalled = False
        self.watch = LightWatch(self)
        self._due_s = [0.0, 0.0]

    def _open(self) -> None:
        config, board = self._config, self.world.board
        self._closing.enter_context(self.state)
        if self.state.left_lit:
            self.permit.trip(TripCause.WATCHDOG, "a program was killed that had lit the laser")
            self.state.lit(False)
        controller = Controller(config.controller, config.laser.max_power_w, board.open_line)
        self.control = ControlService(controller, config.controller, None, self.permit)
        if turn(self.control) and self.control.snapshot.status is None:
            raise DeviceError("no controller")
        if self.world.instrument is not None:
            made = make_laser(config.laser)
            assert made is not None
            self.laser = LaserService(made, permit=self.permit, own_interlock=not self.world.wired)
            turn(self.laser)

    def turn(self) -> None:
        """What its threads do as far as it is due."""
        if not self.stalled:
            for stage in (Stage.CAMERA, Stage.PROCESSING):
                self.permit.moved(stage)
        now_s = self.world.clock.monotonic()
        for place, service in enumerate((self.control, self.laser)):
            if service is not None and now_s >= self._due_s[place]:
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
            self.state.lit(False)
        self._closing.close()


# -- what happens ----------------------------------------------------------------------------------------


def start(world: World) -> None:
    """A person starts a program on a path; where it lights, that is what was asked for."""
    if world.program is not None:
        return
    path = world.random.choice(PATHS)
    world.story.append(path)
    program = Program(world, path)
    try:
        program.__enter__()
    except RigError:
        program._closing.close()
        return
    world.program = program
    if path == "doctor":
        return
    type_at_terminal(world)
    ask(world, program.light)
    if path == "preflight":
        world.live(0.5)
        dark(world)


def ask(world: World, light: Callable[[], object]) -> None:
    """A person asks for light; leave, unless a trip is not acknowledged."""
    program = world.program
    if program is None or program.frozen_to_s > world.clock.monotonic():
        return
    world.oracle.asked = not world.oracle.tripped
    with patched_wait(program):
        try:
            light()
            world.counts["asked, lit"] += 1
        except RigError:
            world.counts["asked, refused"] += 1
    world.look()
    if not world.lit:
        # a light that was refused is not owed
        world.oracle.asked = False


def order_light(world: World) -> None:
    if world.program is not None:
        ask(world, lambda: session_orders.relight(world.program))  # type: ignore[arg-type]


def acknowledge(world: World) -> None:
    """A person who has looked, by the number that is shown, or by another one."""
    program = world.program
    if program is None or (trip := program.permit.latched) is None:
        return
    right = world.random.random() < 0.7
    number = trip.number if right else trip.number + world.random.choice([-1, 1, 7])
    with suppress(RigError):
        session_orders.orders(program)["acknowledge"](f"{number}")
        acknowledged(world, right)


def acknowledged(world: World, right: bool) -> None:
    """The program has taken it: was it right to, and is there leave now?"""
    world.counts["acknowledged"] += 1
    if not right:
        world.found.append("acknowledged by what is no number of the trip")
    elif world.board.closed:
        world.oracle.tripped = False
    elif world.clock.monotonic() - world.opened_s > HEARD_WITHIN_S:
        # what opened just now is a trip of its own, with the next number
        world.found.append("acknowledged while the interlock is open")


def type_at_terminal(world: World) -> None:
    """Keys at the prompt of a trip: words, single letters, the right number."""
    program = world.program
    assert program is not None
    trip = program.permit.latched
    typed = [world.random.choice(TYPED) for _ in range(world.random.randrange(4))]
    if right := trip is not None and world.random.random() < 0.5:
        typed.append(str(trip.number))

    def read() -> str:
        if not typed:
            raise EOFError
        return typed.pop(0)

    with (
        patch.object(leave, "at_terminal", lambda: True),
        patch.object(leave, "input", read, create=True),
        patch.object(leave, "_forget_what_was_typed"),
        patch.object(leave, "say"),
    ):
        leave.ask_leave(program)
    if trip is not None and program.permit.latched is None:
        acknowledged(world, right)


def dark(world: World) -> None:
    """LIGHT OFF, or the end of a look."""
    if world.program is not None and world.program.frozen_to_s <= world.clock.monotonic():
        world.program.darken("a person")
        world.oracle.take("off" if world.board.connected and not world.program.stalled else "cut", trip=False)


def opened(world: World) -> None:
    program, board = world.program, world.board
    sees = program is not None and board.connected and program.frozen_to_s <= world.clock.monotonic()
    short = world.story[-1] == "blinked" and not board.shines
    board.closed = False
    world.opened_s = world.clock.monotonic()
    if not world.wired and world.instrument is not None:
        world.instrument.interlock_closed = False
        world.instrument.light(world.instrument.on)
    world.oracle.take("off", trip=True, unseen=not sees or short)
    if not short:
        world.live(HEARD_WITHIN_S)


def closed(world: World) -> None:
    """The cover or door is closed again."""
    world.board.closed = True
    if not world.wired and world.instrument is not None:
        world.instrument.interlock_closed = True


def blinked(world: World) -> None:
    """For 20 ms; an own interlock is the instrument's matter."""
    if not world.wired:
        return
    opened(world)
    world.board.turn(0.02)
    world.board.closed = True


def trips_lost(world: World) -> None:
    lose = world.board.to_host is bytes
    world.board.to_host = (lambda data: b"" if b"TRIP" in data else data) if lose else bytes


def cable(world: World) -> None:
    board = world.board
    if not world.wired:
        return
    if board.connected and world.random.random() < 0.5:
        # shorter than the watchdog: nothing has happened
        board.connected = False
        world.live(0.3)
        board.connected = True
        return
    board.connected = not board.connected
    if not board.connected:
        world.oracle.take("cut", trip=world.lit)
        # an off that was on its way does not arrive
        world.oracle.since_s, world.oracle.why = world.clock.monotonic(), "cut"
        world.live(WATCHDOG_S + 0.5)


def killed(world: World) -> None:
    if world.program is not None:
        world.oracle.take("cut", trip=world.lit)
        world.program.end(killed=True)
        world.program = None
        world.live(WATCHDOG_S + 0.5 if world.wired else 0.0)
        if not world.wired and world.instrument is not None:
            # as documented: nothing darkens it but the next program
            world.instrument.on = world.was_lit = False


def ended(world: World) -> None:
    if world.program is not None and world.program.frozen_to_s <= world.clock.monotonic():
        world.oracle.take("cut" if not world.board.connected else "off", trip=False)
        with patched_wait(world.program):
            world.program.end(killed=False)
        world.program = None


def frozen(world: World) -> None:
    if world.program is not None and world.wired:
        duration_s = world.random.choice([0.5, WATCHDOG_S + 0.6, 4.0])
        world.program.frozen_to_s = world.clock.monotonic() + duration_s
        if duration_s > WATCHDOG_S:
            world.oracle.take("cut", trip=world.lit)


def stalled(world: World) -> None:
    if world.program is not None:
        world.program.stalled = not world.program.stalled
        if world.program.stalled:
            world.oracle.take("stall", trip=False)


def reset(world: World) -> None:
    if world.wired:
        world.oracle.take("off", trip=world.lit, unseen=True)
        # a board that keeps nothing has forgotten what it had tripped by
        world.oracle.only_unseen = world.oracle.tripped
    world.board.press(b"r")


def strayed(world: World) -> None:
    """Somebody at the laser's panel, or another program: modulation, more power, or its own key."""
    instrument = world.instrument
    if instrument is None or world.program is None or not world.board.connected:
        return
    if world.random.random() < 0.5:
        change, _ = world.random.choice(STRAYED[world.kind])
        change(instrument)
    else:
        instrument.measures = 0.050
    world.oracle.take("cut", trip=True)
    world.live(1.0)
    instrument.measures = None


ACTIONS: tuple[tuple[Callable[[World], None], int], ...] = (
    (start, 6), (order_light, 4), (acknowledge, 6), (dark, 2), (ended, 2), (killed, 1), (frozen, 1),
    (stalled, 1), (opened, 2), (blinked, 2), (trips_lost, 1), (cable, 2), (reset, 1), (strayed, 1),
    (closed, 6),
)  # fmt: skip


@contextmanager
def patched_wait(program: Program) -> Iterator[None]:
    with (
        patch.object(laser_module, "wait_for_command", program.wait),
        patch("rig.devices.lit_devices.wait_for_command", program.wait),
    ):
        yield


def sequence(seed: int, steps: int, folder: Path) -> World:
    """One sequence; `found` of the world holds what is wrong, `story` how it came about."""
    with ExitStack() as stack:
        monkeypatch = stack.enter_context(pytest.MonkeyPatch.context())
        clock = stepped_clock(monkeypatch)
        monkeypatch.setenv("XDG_STATE_HOME", str(folder / str(seed)))
        monkeypatch.setattr("rig.control.safety_state._device_at", lambda _: "")
        world = World(seed, clock, folder)
        monkeypatch.setattr(serial_laser, "SerialPort", world.open_laser)
        monkeypatch.setattr(laser_module, "time", clock)
        monkeypatch.setattr("rig.devices.light_watch.time", clock)
        monkeypatch.setattr("rig.devices.lit_devices.time", clock)
        actions, weights = zip(*ACTIONS, strict=True)
        for _ in range(steps):
            action = world.random.choices(actions, weights)[0]
            world.story.append(action.__name__)
            action(world)
            world.look()
            world.live(world.random.choice([0.01, 0.2, 1.0, 3.0]))
            if world.found:
                break
        if world.program is not None:
            with suppress(Exception):
                world.program._closing.close()
    return world


def run_sequences(count: int, steps: int, first: int = 0) -> dict[str, Any]:
    """So many sequences; what was found, and how often there was light at all."""
    counts: Counter[str] = Counter()
    found: list[str] = []
    place = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(os.environ.get("TMPDIR", "/tmp"))
    folder = place / f"safety-{os.getpid()}"
    for seed in range(first, first + count):
        world = sequence(seed, steps, folder)
        counts += world.counts
        found += [f"{seed}: {text} ({world.kind}): {' '.join(world.story)}" for text in world.found[:1]]
    return {"sequences": count, "steps": count * steps, **counts, "violations": found}
