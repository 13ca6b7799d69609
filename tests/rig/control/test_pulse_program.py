"""The program that makes the laser's pulses, cycle by cycle, as the RP2040's manual has its instructions.

No board and no emulator of one is at hand: this runs the program of `firmware/pulse.py` in a state machine
written from section 3.4 of the manual, one instruction a tick.
"""

import importlib.util
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).resolve().parents[3] / "rig" / "control" / "firmware" / "pulse.py"


class StateMachine:
    """What `rp2.StateMachine` does with the few instructions of the program."""

    def __init__(self, number: int, program: list[tuple[Any, ...]], *, freq: int, **pins: Any) -> None:
        self.tick_us = 1e6 / freq
        self.program = [words for words in program if words[0] not in ("label", "wrap_target", "wrap")]
        self.labels: dict[str, int] = {}
        self.wraps_to = 0
        place = 0
        for words in program:
            if words[0] == "label":
                self.labels[words[1]] = place
            elif words[0] == "wrap_target":
                self.wraps_to = place
            place += words[0] not in ("label", "wrap_target", "wrap")
        self.fifo: list[int] = []
        self.registers = {"x": 0, "isr": 0, "osr": 0}
        self.next = 0
        self.output = 0
        self.running = False

    def put(self, value: int) -> None:
        assert 0 <= value < 2**32
        self.fifo.append(value)

    def active(self, on: int) -> None:
        self.running = bool(on)

    def tick(self, level: int) -> int:
        """One tick with this level at the input; returns the output's."""
        name, *words = self.program[self.next]
        following = self.next + 1
        if name == "pull":
            self.registers["osr"] = self.fifo.pop(0)
        elif name == "mov":
            self.registers[words[0]] = self.registers[words[1]]
        elif name == "wait":
            following = following if level == words[0] else self.next
        elif name == "jmp":
            assert words[0] == "x_dec"
            following = self.labels[words[1]] if self.registers["x"] else following
            self.registers["x"] = (self.registers["x"] - 1) % 2**32
        else:
            assert name == "set"
            self.output = words[1]
        self.next = following if following < len(self.program) else self.wraps_to
        return self.output


@pytest.fixture
def pulses(monkeypatch: pytest.MonkeyPatch) -> Callable[[float, float], StateMachine]:
    """Makes the pulses of the firmware's own file."""
    rp2: Any = types.ModuleType("rp2")
    rp2.PIO = types.SimpleNamespace(OUT_LOW=0)
    rp2.StateMachine = StateMachine
    module: Any = None

    def asm_pio(**_: Any) -> Callable[[Callable[[], None]], list[tuple[Any, ...]]]:
        def assembled(function: Callable[[], None]) -> list[tuple[Any, ...]]:
            program: list[tuple[Any, ...]] = []
            names = function.__globals__
            for name in ("pull", "mov", "wait", "jmp", "set", "label", "wrap_target", "wrap"):
                names[name] = lambda *words, name=name: program.append((name, *words))
            names |= {word: word for word in ("block", "isr", "osr", "x", "x_dec", "pin", "pins")}
            function()
            return program

        return assembled

    rp2.asm_pio = asm_pio
    monkeypatch.setitem(sys.modules, "rp2", rp2)
    found = importlib.util.spec_from_file_location("pulse", FILE)
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)

    def make(delay_us: float, width_us: float) -> StateMachine:
        made: StateMachine = module.Pulses(None, None, delay_us, width_us)._machine
        return made

    return make


@pytest.mark.parametrize(("delay_us", "width_us"), [(0.0, 1.0), (0.4, 1.0), (12.3, 45.6), (200.0, 20.0)])
def test_one_pulse_in_each_exposure_with_the_delay_and_the_width_that_are_asked_for(
    pulses: Callable[[float, float], StateMachine], delay_us: float, width_us: float
) -> None:
    machine = pulses(delay_us, width_us)
    assert machine.running
    period, exposed, count = 5000, 3000, 3
    # high when it is started: that exposure has begun already
    levels = [1] * 50 + ([0] * (period - exposed) + [1] * exposed) * count
    seen = [machine.tick(level) for level in levels]
    begins = [i for i in range(1, len(seen)) if seen[i] > seen[i - 1]]
    ends = [i for i in range(1, len(seen)) if seen[i] < seen[i - 1]]
    edges = [i for i in range(1, len(levels)) if levels[i] > levels[i - 1]]
    assert len(begins) == len(ends) == len(edges) == count
    for edge, begin, end in zip(edges, begins, ends, strict=True):
        assert (begin - edge) * machine.tick_us == pytest.approx(max(delay_us, 0.4), abs=0.051)
        assert (end - begin) * machine.tick_us == pytest.approx(width_us, abs=0.051)


def test_an_exposure_that_does_not_end_gives_one_pulse(
    pulses: Callable[[float, float], StateMachine],
) -> None:
    machine = pulses(1.0, 2.0)
    seen = [machine.tick(level) for level in [0] * 10 + [1] * 10_000]
    assert sum(seen) == 20
