"""Output and input of `rig balance`: on the terminal, as JSON lines, and as the dialogue of the desk."""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from processing.balance import BalanceCheck, Turn, Unreachable
from processing.deflections import Deflections
from rig.instrument import swing_text, turn_text
from rig.terminal import (
    NOT_KNOWN,
    Table,
    judged_number,
    print_json_line,
    print_line,
    print_tables,
    say,
)

_MAX_LIVE_PIECES = 40
_MAX_TRAJECTORY_POINTS = 1000
_WHOLE = ("found", "rejected", "wrong", "ask")
"""Kinds of the lines after which no measurement is under way."""
_BACKLASH_NOTE = "the second turn takes the play out of the screw"


class BalanceStage(StrEnum):
    """The stage of the dialogue."""

    IDLE = "idle"
    MEASURING = "measuring"
    ASKING = "asking"
    ENDED = "ended"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class BalanceDialogue:
    """The state of the dialogue as it is shown; an undetermined quantity is never "go".

    `advice` says in few words what to do, `detail` why; `turn` is the advised turn as the reporter wrote it;
    `faults` are the present ones, `before` those before the last turn; `x` and `y` are the trajectory of the
    spot in arcsec; `problem` is the problem of an invalid answer.
    """

    stage: BalanceStage
    advice: str = ""
    detail: str = ""
    turn: Mapping[str, Any] | None = None
    faults: Sequence[Mapping[str, Any]] = ()
    before: Sequence[Mapping[str, Any]] = ()
    x: list[float | None] = field(default_factory=list)
    y: list[float | None] = field(default_factory=list)
    problem: str = ""

    @property
    def asks(self) -> bool:
        """Whether the dialogue waits for an answer."""
        return self.stage is BalanceStage.ASKING

    @property
    def unknown(self) -> list[str]:
        """Names of the undetermined quantities."""
        return [str(fault["name"]) for fault in self.faults if fault["ok"] is None]


def balance_dialogue(
    lines: Sequence[Mapping[str, Any]], output: Sequence[str], *, running: bool, failed: bool
) -> BalanceDialogue:
    """The dialogue from the JSON lines that the command has printed, answers to it, and other `output`.

    Parameters
    ----------
    running, failed
        Whether the command runs, and whether it ended with an error.
    """
    asks = running and bool(lines) and lines[-1]["kind"] == "ask"
    stage = (
        BalanceStage.ASKING if asks
        else BalanceStage.MEASURING if running
        else BalanceStage.FAILED if failed
        else BalanceStage.ENDED
    )  # fmt: skip
    # what is advised for a state that has been changed since must not be done again
    is_whole = not lines or lines[-1]["kind"] in _WHOLE or lines[-1].get("text") == "q"
    last = _last_line(lines, "found", "rejected") if is_whole or stage is BalanceStage.MEASURING else {}
    judged = _last_line(lines, "live") if stage is BalanceStage.MEASURING else last
    faults = judged.get("faults") or _last_line(lines, "found").get("faults") or []
    x, y = _trajectory(lines, whole=stage is not BalanceStage.MEASURING)
    problem = next((str(one["problem"]) for one in list(lines)[-2:] if one.get("problem")), "")
    turn = None if stage is BalanceStage.MEASURING else last.get("turn")
    advice, detail = _advice(stage, last, turn, output)
    # after it the advice is given again, and asked for the next turn
    forgotten = next((str(one["forgotten"]) for one in list(lines)[-3:] if "forgotten" in one), "")
    detail = "; ".join(filter(None, (forgotten, detail)))
    return BalanceDialogue(stage, advice, detail, turn, faults, last.get("before") or [], x, y, problem)


def _advice(
    stage: BalanceStage, last: Mapping[str, Any], turn: Mapping[str, Any] | None, output: Sequence[str]
) -> tuple[str, str]:
    """The advice, and its reason."""
    if stage is BalanceStage.MEASURING:
        return "Hands off: measuring", ""
    why, hint, text = (str(last.get(key) or "") for key in ("why", "hint", "text"))
    if stage is BalanceStage.FAILED:
        return "The measurement has failed", " ".join(list(output)[-2:]) or why
    if turn is not None:
        parts = ", then ".join(
            f"{abs(part):.2f} turns {'clockwise' if part > 0 else 'anticlockwise'}" for part in turn["parts"]
        )
        return f"Turn weight {turn['weight']}: {parts}", "; ".join(
            filter(None, (why, hint, str(turn["why"]), *_cautions(turn)))
        )
    if last.get("kind") == "rejected":
        return "Measure again", "; ".join(filter(None, (why, hint)))
    unknown = [str(fault["name"]) for fault in last.get("faults") or () if fault["ok"] is None]
    if unknown:
        # an unmeasured quantity may still be wrong
        return "Measure again, with a larger swing", f"not known yet: {', '.join(unknown)}"
    return (text[:1].upper() + text[1:] or "Measure"), ""


def _cautions(turn: Mapping[str, Any]) -> Iterator[str]:
    """What to heed when a turn is made."""
    if len(turn["parts"]) > 1:
        yield _BACKLASH_NOTE
    if turn["swing_arcsec"] is not None:
        yield swing_text(turn["swing_arcsec"])


def _last_line(lines: Sequence[Mapping[str, Any]], *kinds: str) -> Mapping[str, Any]:
    return next((one for one in reversed(lines) if one["kind"] in kinds), {})


def _trajectory(
    lines: Sequence[Mapping[str, Any]], *, whole: bool
) -> tuple[list[float | None], list[float | None]]:
    """The last seconds of the trajectory, or all of the last measurement if `whole`, thinned."""
    since = 0
    if whole:
        drawn = [k for k, one in enumerate(lines) if one["kind"] == "trajectory"]
        ends = [k for k, one in enumerate(lines) if one["kind"] in ("found", "rejected")]
        since = max((end for end in ends if drawn and end < drawn[-1]), default=0)
    pieces = [one for one in lines[since:] if one["kind"] == "trajectory"]
    pieces = pieces if whole else pieces[-_MAX_LIVE_PIECES:]
    x, y = ([value for piece in pieces for value in piece[axis]] for axis in ("x", "y"))
    step = max(1, len(x) // _MAX_TRAJECTORY_POINTS)
    return x[::step], y[::step]


def print_checks(checks: Sequence[BalanceCheck], before: Sequence[BalanceCheck]) -> None:
    """Print a table of the balance."""
    head = ("", "number", "now", *(["before"] if before else []), "limit", "what it means")
    rows: list[list[str]] = []
    for k, check in enumerate(checks):
        row = [("go" if check.ok else "NO") if check.is_known else "?", check.name, _number(check)]
        if before:
            row.append(_number(before[k]))
        rows.append([*row, f"{check.limit:g} {check.unit}".rstrip(), "" if check.ok else check.meaning])
    print_tables([Table("balance", "", head, rows)])


def _number(check: BalanceCheck) -> str:
    if math.isnan(check.value):
        return NOT_KNOWN
    return f"{judged_number(check.value, check.u_value, check.limit)} {check.unit}".rstrip()


QUESTION = (
    "turned (weight turns, e.g. x 1.5, or x 1.5 -0.75 in sequence; m: measure again;"
    " f: forget the last turn learned; q: end)? "
)
_POINTS_PER_LINE = 12


class Reporter:
    """Reports the measurements of the balance to a person at the terminal, and asks for the turn made."""

    def report_trajectory(self, at: Deflections) -> None:
        """Report the deflections of some frames: nothing here, because the live view shows them."""

    def report_live(self, checks: Sequence[BalanceCheck]) -> None:
        """Report the balance while it is measured."""
        parts = [f"{f.name} {f.value:+.3g} {f.unit}".rstrip() for f in checks[:2] if math.isfinite(f.value)]
        say("  ".join(parts))

    def report_measurement(
        self,
        checks: Sequence[BalanceCheck],
        before: Sequence[BalanceCheck],
        advice: Turn | Unreachable | None,
    ) -> None:
        """Report a sound measurement, the checks before the last turn (or empty), and the advised turn."""
        print_checks(checks, before)
        print_line(turn_text(advice, checks))

    def report_rejection(self, why: str, hint: str, back: Turn | None) -> None:
        """Report a rejected measurement; the turn `back` may help."""
        say(f"this measurement is not used: {why}")
        if hint:
            say(hint)
        if back is not None:
            say(turn_text(back, []))

    def ask(self) -> str:
        """The operator's answer on what was turned; raises EOFError at the end."""
        # a measurement lights the laser, which a single key must not do
        while not (answer := input(QUESTION)).strip():
            say("nothing done: m and Enter measures again, which lights the laser")
        return answer

    def report_invalid(self, problem: str) -> None:
        """Report an invalid answer."""
        say(problem)

    def report_forgotten(self, text: str) -> None:
        """Report which turn was forgotten."""
        say(text)


class InJsonLines(Reporter):
    """Reports to a program: a JSON object on each line of stdout, answers line by line on stdin."""

    def report_trajectory(self, at: Deflections) -> None:
        step = max(1, len(at) // _POINTS_PER_LINE)
        print_json_line("trajectory", {"x": at.shown_x[::step].tolist(), "y": at.shown_y[::step].tolist()})

    def report_live(self, checks: Sequence[BalanceCheck]) -> None:
        print_json_line("live", {"faults": [_check_values(one) for one in checks]})

    def report_measurement(
        self,
        checks: Sequence[BalanceCheck],
        before: Sequence[BalanceCheck],
        advice: Turn | Unreachable | None,
    ) -> None:
        turn = advice if isinstance(advice, Turn) else None
        stated = {
            "faults": [_check_values(one) for one in checks],
            "before": [_check_values(one) for one in before],
        }
        print_json_line("found", {**stated, "text": turn_text(advice, checks), "turn": _turn(turn)})

    def report_rejection(self, why: str, hint: str, back: Turn | None) -> None:
        text = turn_text(back, []) if back is not None else ""
        print_json_line("rejected", {"why": why, "hint": hint, "text": text, "turn": _turn(back)})

    def ask(self) -> str:
        print_json_line("ask", {"question": QUESTION})
        answer = sys.stdin.readline()
        if not answer:
            raise EOFError
        return answer

    def report_invalid(self, problem: str) -> None:
        print_json_line("wrong", {"problem": problem})

    def report_forgotten(self, text: str) -> None:
        print_json_line("forgotten", {"forgotten": text})


def _check_values(one: BalanceCheck) -> dict[str, Any]:
    return {**one._asdict(), "ok": one.ok if one.is_known else None}


def _turn(turn: Turn | None) -> dict[str, Any] | None:
    if turn is None:
        return None
    swing = turn.swing_arcsec if math.isfinite(turn.swing_arcsec) else None
    return {"weight": turn.weight, "parts": list(turn.parts), "why": turn.why, "swing_arcsec": swing}
