"""How `rig balance` tells what it found, and asks what was turned: on a terminal, or in JSON lines."""

import math
import sys
from collections.abc import Sequence
from typing import Any, Protocol

from processing.balance import Fault, Turn, Unreachable
from processing.deflections import Deflections
from rig.instrument import turn_text
from rig.presentation import (
    NOT_KNOWN,
    Table,
    print_json_line,
    print_line,
    print_tables,
    say,
    with_uncertainty,
)


def print_faults(faults: Sequence[Fault], before: Sequence[Fault]) -> None:
    """Print a table of the balance."""
    head = ("", "number", "now", *(["before"] if before else []), "limit", "what it means")
    rows: list[list[str]] = []
    for k, fault in enumerate(faults):
        row = [("go" if fault.ok else "NO") if fault.is_known else "?", fault.name, _number(fault)]
        if before:
            row.append(_number(before[k]))
        rows.append([*row, f"{fault.limit:g} {fault.unit}".rstrip(), "" if fault.ok else fault.meaning])
    print_tables([Table("balance", "", head, rows, head, rows)])


def _number(fault: Fault) -> str:
    if math.isnan(fault.value):
        return NOT_KNOWN
    return f"{with_uncertainty(fault.value, fault.u_value, signed=True)} {fault.unit}".rstrip()


QUESTION = (
    "turned (weight turns, e.g. x 1.5, or x 1.5 -0.75 in sequence; m: measure again;"
    " f: forget the last turn learned; q: end)? "
)
_POINTS = 12


class Reporter(Protocol):
    """What is said of a look: trajectory, balances, faults with advice or why it is unused; a question."""

    def way(self, at: Deflections) -> None:
        """Where the spot was in some frames."""

    def live(self, faults: Sequence[Fault]) -> None:
        """The balance while it is measured."""

    def found(
        self, faults: Sequence[Fault], before: Sequence[Fault], advice: Turn | Unreachable | None
    ) -> None:
        """A sound measurement, the one before the last turn (or empty), and what to turn."""

    def rejected(self, why: str, hint: str, back: Turn | None) -> None:
        """A measurement that is not used; `back` may help."""

    def ask(self) -> str:
        """What was turned, as the operator states it; raises EOFError at the end."""

    def wrong(self, problem: str) -> None:
        """An answer that is none."""


class OnTerminal:
    """For a person at the terminal."""

    def way(self, at: Deflections) -> None:
        """Nothing: the live view shows it."""

    def live(self, faults: Sequence[Fault]) -> None:
        parts = [f"{f.name} {f.value:+.3g} {f.unit}".rstrip() for f in faults[:2] if math.isfinite(f.value)]
        say("  ".join(parts))

    def found(
        self, faults: Sequence[Fault], before: Sequence[Fault], advice: Turn | Unreachable | None
    ) -> None:
        print_faults(faults, before)
        print_line(turn_text(advice, faults))

    def rejected(self, why: str, hint: str, back: Turn | None) -> None:
        say(f"this measurement is not used: {why}")
        if hint:
            say(hint)
        if back is not None:
            say(turn_text(back, []))

    def ask(self) -> str:
        # each look lights the laser, and one key must not
        while not (answer := input(QUESTION)).strip():
            say("nothing done: m and Enter measures again, which lights the laser")
        return answer

    def wrong(self, problem: str) -> None:
        say(problem)


class InJsonLines:
    """For a program: one object a line on stdout, answers line by line on stdin."""

    def way(self, at: Deflections) -> None:
        step = max(1, len(at) // _POINTS)
        print_json_line("way", {"x": at.shown_x[::step].tolist(), "y": at.shown_y[::step].tolist()})

    def live(self, faults: Sequence[Fault]) -> None:
        print_json_line("live", {"faults": [_fault(one) for one in faults]})

    def found(
        self, faults: Sequence[Fault], before: Sequence[Fault], advice: Turn | Unreachable | None
    ) -> None:
        turn = advice if isinstance(advice, Turn) else None
        stated = {"faults": [_fault(one) for one in faults], "before": [_fault(one) for one in before]}
        print_json_line("found", {**stated, "text": turn_text(advice, faults), "turn": _turn(turn)})

    def rejected(self, why: str, hint: str, back: Turn | None) -> None:
        text = turn_text(back, []) if back is not None else ""
        print_json_line("rejected", {"why": why, "hint": hint, "text": text, "turn": _turn(back)})

    def ask(self) -> str:
        print_json_line("ask", {"question": QUESTION})
        answer = sys.stdin.readline()
        if not answer:
            raise EOFError
        return answer

    def wrong(self, problem: str) -> None:
        print_json_line("wrong", {"problem": problem})


def _fault(one: Fault) -> dict[str, Any]:
    return {**one._asdict(), "ok": one.ok if one.is_known else None}


def _turn(turn: Turn | None) -> dict[str, Any] | None:
    if turn is None:
        return None
    swing = turn.swing_arcsec if math.isfinite(turn.swing_arcsec) else None
    return {"weight": turn.weight, "parts": list(turn.parts), "why": turn.why, "swing_arcsec": swing}
