"""Faults of lasers with a port of their own: emulated instruments on a stepped clock, the real drivers."""

import itertools
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from processing.errors import DeviceError, RigError
from rig.control.lasers import LaserRefused
from tests.benchmarks.safety_faults import Row
from tests.benchmarks.safety_world import Program, World, patched_wait, stepped_world
from tests.rig.control.instruments import Instrument
from tests.rig.control.lasers.pairs import FAMILIES, STRAYED

_STEP_S, _LONGEST_S, _LOOKED_AT_FOR_S = 0.01, 8.0, 4.0


def _too_bright(world: World, instrument: Instrument) -> None:
    instrument.measures = 0.050


def _modulated(world: World, instrument: Instrument) -> None:
    STRAYED[world.kind][0][0](instrument)


def _lit_at_its_panel(world: World, instrument: Instrument) -> None:
    assert world.program is not None
    world.program.darken("a person")
    world.live(1.0)
    instrument.light(True)


def _interlock(world: World, instrument: Instrument) -> None:
    instrument.interlock_closed = False
    instrument.light(instrument.on)


def _silent(world: World, instrument: Instrument) -> None:
    instrument.silent = True


def _deaf(world: World, instrument: Instrument) -> None:
    instrument.deaf_to_off = 2
    assert world.program is not None
    world.program.darken("a person")


def _killed(world: World, instrument: Instrument) -> None:
    assert world.program is not None
    world.program.end(killed=True)
    world.program = None


FAULTS: dict[str, tuple[Callable[[World, Instrument], None], bool]] = {
    "50 mW or mA measured, 30 allowed": (_too_bright, False),
    "another program switches its modulation on": (_modulated, False),
    "switched on at its panel": (_lit_at_its_panel, False),
    "its own interlock opened for 4 s": (_interlock, False),
    "its cable pulled, put in again": (_silent, False),
    "LIGHT OFF, and it is deaf to the first two": (_deaf, False),
    "program killed, interlock not wired": (_killed, False),
    "program killed, interlock wired to the board": (_killed, True),
}
TRIALS = list(itertools.product(FAMILIES, FAULTS))


def measured(kind: str, fault: str, folder: Path) -> Row:
    """Light, fault, dark, the fault gone, time, then another program that asks for light."""
    act, wired = FAULTS[fault]
    number = TRIALS.index((kind, fault))
    with stepped_world(number, folder, kind, wired) as world:
        instrument = world.instrument
        assert instrument is not None
        world.program = Program(world, "run")
        world.program.__enter__()
        world.oracle.asked = True
        with patched_wait(world.program):
            world.program.light()
        # at another moment between two readings of its state each time
        world.live(2.0 + 0.037 * number)
        assert world.lit
        world.oracle.watching = False
        began_s = world.clock.monotonic()
        act(world, instrument)
        if act is _lit_at_its_panel:
            began_s = world.clock.monotonic()
        while world.lit and world.clock.monotonic() - began_s < _LONGEST_S:
            world.live(_STEP_S)
        dark_s = None if world.lit else world.clock.monotonic() - began_s
        world.live(1.0)
        instrument.measures, instrument.silent, instrument.interlock_closed = None, False, True
        before = world.counts["lit"]
        world.live(_LOOKED_AT_FOR_S)
        relit = world.counts["lit"] - before
        return Row(f"run, {kind}", fault, dark_s, relit, *_asked(world, relit))


def _asked(world: World, relit: int) -> tuple[str, str]:
    if world.program is not None:
        with patched_wait(world.program), suppress(DeviceError):
            world.program.end(killed=False)
    program = world.program = Program(world, "run")
    program.__enter__()
    world.live(1.0)
    needed = "asked"
    with patched_wait(program):
        if (trip := program.permit.latched) is not None:
            with suppress(LaserRefused, RigError):
                program.light()
            if world.lit:
                return needed, "lit without an acknowledgement"
            program.acknowledge(trip.number, "a person")
            needed = f"asked, acknowledged ({trip.cause})"
        program.light(on_request=True)
    world.live(0.5)
    wrong = "" if world.lit else "not lit afterwards"
    return needed, wrong or "lit again by itself" * bool(relit)
