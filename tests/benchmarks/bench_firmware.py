"""The firmware's latch under random commands, inputs and bytes, and over a week; the board's ticks wrap.

Run as ``python -m tests.benchmarks firmware [--quick]``. An oracle of a few lines says when there may be
light: in a session, with the loop closed, and with no opening and no reset since the last acknowledgement of
the number, or pressing of the button.
"""

import random
import sys
import tracemalloc
from typing import Any

from rig.control.protocol import encode
from tests.rig.control.stepped import Clock, SteppedBoard

_PERIOD = 1 << 30
"""MicroPython's ticks wrap at this many ms; the board starts shortly before."""
_TURN_MS = 20


class _Board(SteppedBoard):
    """Its outputs are looked at as they change, and not remembered."""

    latches_at_start = True

    def __init__(self, clock: Clock) -> None:
        self.welded = False
        self.power_w = 0.0
        super().__init__(clock)

    def ticks_ms(self) -> int:
        return (_PERIOD - 1_060_000 + self.clock.now_ns // 1_000_000) % _PERIOD

    def ticks_diff(self, later: int, earlier: int) -> int:
        return (later - earlier + _PERIOD // 2) % _PERIOD - _PERIOD // 2

    def ticks_add(self, start: int, delta_ms: int) -> int:
        return (start + delta_ms) % _PERIOD

    def set_laser(self, on: bool, power_w: float) -> None:
        self._lit = on and self.relay_works
        self.power_w = power_w if on else 0.0

    def laser_enabled(self) -> bool:
        return self._lit or self.welded

    def _say(self, name: str, *values: float) -> None:
        """Nothing is kept: a million steps are."""


class _Host:
    """Sends lines, and knows from the answers what was acknowledged."""

    def __init__(self, board: _Board) -> None:
        self.board, self._tag = board, 0

    def ask(self, command: str) -> str:
        self._tag = self._tag % 65535 + 1
        self.board.sent()
        self.board.hear(b"\n" + encode(self._tag, command))
        self.board.firmware.step()
        answers = [one for one in self.board.sent().split(b"\n") if one.startswith(b"#%d " % self._tag)]
        return answers[-1].decode() if answers else ""


def fuzz(steps: int, seed: int) -> dict[str, Any]:
    """Random steps; the numbers of what came about, and of lights that nobody allowed."""
    choose, clock = random.Random(seed), Clock()
    board = _Board(clock)
    host = _Host(board)
    found = dict.fromkeys(("lit", "trips", "acknowledged", "resets", "wraps", "without leave", "too much"), 0)
    owed = True
    latched, was_lit, ticks = board.firmware.number, False, board.ticks_ms()
    for step in range(steps):
        number = board.firmware.number
        match choose.random():
            case x if x < 0.30:
                host.ask("SYST:HEAR?")
            case x if x < 0.50:
                host.ask("LAS:STAT ON")
            case x if x < 0.55:
                host.ask(f"LAS:POW {choose.choice(['5e-4', '1e-3', '1.001e-3', 'nan', '-1'])}")
            case x if x < 0.63:
                host.ask(f"SYST:SESS {choose.randrange(9)},{choose.choice([100, 1500, 5000, 6000])}")
            case x if x < 0.80:
                wanted = number + choose.choice([0, 0, 0, -1, 1])
                if " OK" in host.ask(f"SYST:TRIP:ACK {wanted}"):
                    owed = False
                    found["acknowledged"] += 1
            case x if x < 0.84:
                board.closed = choose.random() < 0.8
            case x if x < 0.86:
                board.hear(choose.randbytes(choose.randrange(1, 200)))
            case x if x < 0.865:
                board.press(b"r")
                found["resets"] += 1
                owed = True
            case x if x < 0.87:
                board.light = choose.choice([None, None, True, False])
            case x if x < 0.875:
                board.pressed = not board.pressed
            case x if x < 0.88:
                board.welded, board.relay_works = choose.random() < 0.3, choose.random() < 0.8
            case x if x < 0.9:
                host.ask(choose.choice(["LAS:STAT OFF", "SYST:SAFE", "SYST:SESS:END", "*RST", "SYST:TRIP?"]))
            case _:
                clock.now_ns += choose.choice([20, 20, 20, 200, 1600, 6000]) * 1_000_000
        owed = (owed or not board.closed) and not board.pressed
        board.turn()
        clock.now_ns += _TURN_MS * 1_000_000
        firmware = board.firmware
        lit = board._lit
        found["trips"] += firmware.number > latched
        latched = max(latched, firmware.number)
        found["wraps"] += board.ticks_ms() < ticks
        ticks = board.ticks_ms()
        if lit and not was_lit:
            found["lit"] += 1
        if lit and (owed or not firmware.token or not board.closed):
            found["without leave"] += 1
        if lit and board.power_w > board.laser_max_w:
            found["too much"] += 1
        was_lit = lit
        if step % 50_000 == 0:
            print(f"  {step} of {steps}", file=sys.stderr)
    return found


def week(days: float) -> dict[str, Any]:
    """A lit session that is fed twice a second, its errors unread: is it always lit, does memory grow?"""
    clock = Clock()
    board = _Board(clock)
    host = _Host(board)
    host.ask("SYST:SESS A,1500")
    host.ask(f"SYST:TRIP:ACK {board.firmware.number}")
    host.ask("LAS:POW 5e-4")
    host.ask("LAS:STAT ON")
    beats = round(days * 86400 / 0.5)
    sizes, dark = [], 0
    tracemalloc.start()
    for beat in range(beats):
        clock.now_ns += 500_000_000
        host.ask("SYST:HEAR?")
        host.ask("NONSENSE")
        dark += not board._lit
        if beat % (beats // 10) == beats // 20:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    return {"beats": beats, "dark": dark, "heap growth, bytes": sizes[-1] - sizes[1]}


def run(quick: bool = False) -> dict[str, Any]:
    """Both, as plain numbers."""
    return {"fuzz": fuzz(20_000 if quick else 1_000_000, 7), "week": week(0.1 if quick else 7.0)}
