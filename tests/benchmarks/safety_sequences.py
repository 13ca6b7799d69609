"""Random sequences of faults, keys and commands over all paths to light, held against the oracle of leave."""

import io
import os
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

from processing.errors import RigError
from rig.control import rig_state_path, state_folder
from rig.control.presses import Presses
from rig.devices import SessionNews, acknowledgement
from rig.measure import session_orders
from rig.measure.session_orders import Notes
from tests.benchmarks.safety_world import (
    HEARD_WITHIN_S,
    PATHS,
    WATCHDOG_S,
    Program,
    World,
    patched_wait,
    stepped_world,
)
from tests.rig.control.lasers.pairs import STRAYED
from tests.rig.control.stepped import SpoiledLine

TYPED = ("", "a", "y", "s", "glass ball", "light", "acknowledge", "0", "999")


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
    if world.random.random() < 0.15:
        pressed(world)
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
    with patched_wait(program), suppress(RigError):
        session_orders.orders(program, Notes(Path(), ""), SessionNews())["acknowledge"](f"{number}")
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
        typed += [str(trip.number), world.random.choice(TYPED)]

    with (
        patched_wait(program),
        patch.object(acknowledgement, "at_terminal", lambda: True),
        patch.object(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in typed))),
        patch.object(acknowledgement, "_discard_typing"),
        patch.object(acknowledgement, "say"),
    ):
        acknowledgement.ask_acknowledgement(program)
    if trip is not None and program.permit.latched is None:
        acknowledged(world, right)


def dark(world: World) -> None:
    """LIGHT OFF, or the end of a look."""
    if world.program is not None and world.program.frozen_to_s <= world.clock.monotonic():
        world.program.darken("a person")
        # a command wakes the threads
        world.program.turn(now=True)
        world.oracle.take("off" if world.quick and not world.program.stalled else "cut", trip=False)


def pressed(world: World) -> None:
    """LIGHT OFF at a desk whose order reaches nobody: it is left beside the rig's state."""
    path = rig_state_path(world.config.laser, world.config.controller)
    assert path is not None
    Presses(path.with_suffix(".off")).press("the desk")
    world.counts["pressed"] += 1
    world.oracle.take("off" if world.quick else "cut", trip=True)


def full(world: World) -> None:
    """The disk of the rig's state has no room left for a while, in which things go on."""
    world.full = True
    world.counts["full"] += 1
    for _ in range(3):
        world.random.choice([start, order_light, acknowledge, pressed, opened, killed, ended])(world)
        world.look()
        world.live(0.5)
    world.full = False


def gone(world: World) -> None:
    """The rig's state is deleted as a whole; a program that has it remembers it."""
    shutil.rmtree(state_folder(), ignore_errors=True)
    world.counts["gone"] += 1
    if world.program is None:
        world.oracle.take("off", trip=True)


def late(world: World) -> None:
    """Answers come late, by less than a command's repetitions; somebody acts meanwhile."""
    world.slow = True
    world.line.late(world.random.choice([0.05, 0.15, 0.25]))
    world.random.choice([dark, pressed, order_light, acknowledge, World.look])(world)
    world.live(2.5)
    world.line.mend()
    world.live(0.5)
    world.slow = False


def old(world: World) -> None:
    """Answers of before are heard for all that is asked, or none, or what is no state."""
    spoiled = (SpoiledLine.old_replies, SpoiledLine.mute, SpoiledLine.nan, SpoiledLine.very_late)
    world.random.choice(spoiled)(world.line)
    world.slow = True
    if world.wired:
        world.oracle.take("cut", trip=False)
    world.random.choice([pressed, acknowledge, World.look, World.look])(world)
    world.live(3.0)
    world.line.mend()
    world.live(1.0)
    world.slow = False


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
    (start, 6), (order_light, 7), (acknowledge, 12), (dark, 2), (ended, 2), (killed, 1), (frozen, 1),
    (stalled, 1), (opened, 2), (blinked, 2), (trips_lost, 1), (cable, 2), (reset, 1), (strayed, 1),
    (closed, 6), (pressed, 2), (full, 1), (gone, 1), (late, 1), (old, 1),
)  # fmt: skip


def sequence(seed: int, steps: int, folder: Path) -> World:
    """One sequence; `found` of the world holds what is wrong, `story` how it came about."""
    with stepped_world(seed, folder) as world:
        actions, weights = zip(*ACTIONS, strict=True)
        for _ in range(steps):
            action = world.random.choices(actions, weights)[0]
            world.story.append(action.__name__)
            action(world)
            world.look()
            world.live(world.random.choice([0.01, 0.2, 1.0, 3.0]))
            if world.found:
                break
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
    return {"sequences": count, "steps": count * steps, **counts, "violations": found, "violated": len(found)}
