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
from rig.terminal import NOT_KNOWN, Table, judged_number, print_json_line, print_line, print_tables, say

_MAX_LIVE_PIECES = 40
"""Pieces of the trajectory that are shown while a measurement is under way."""
_MAX_TRAJECTORY_POINTS = 1000
_IDLE_KINDS = ("found", "rejected", "wrong", "ask")
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
    """The state of the dialogue as it is shown; an undetermined quantity is never "go"."""

    stage: BalanceStage
    advice: str = ""
    """What to do, in few words."""
    detail: str = ""
    """The reason of the advice."""
    turn: Mapping[str, Any] | None = None
    """The advised turn as the reporter wrote it."""
    faults: Sequence[Mapping[str, Any]] = ()
    earlier_faults: Sequence[Mapping[str, Any]] = ()
    """The faults before the last turn."""
    x: list[float | None] = field(default_factory=list)
    y: list[float | None] = field(default_factory=list)
    """The trajectory of the spot, x and y in arcsec."""
    problem: str = ""
    """What is wrong with an invalid answer."""

    @property
    def asks(self) -> bool:
        """Whether the dialogue waits for an answer."""
        return self.stage is BalanceStage.ASKING

    @property
    def unknown(self) -> list[str]:
        """Names of the undetermined quantities."""
        return _unknown(self.faults)


def _unknown(faults: Sequence[Mapping[str, Any]]) -> list[str]:
    return [str(fault["name"]) for fault in faults if fault["ok"] is None]


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
    # advice for a state that a turn has changed since must not be followed again
    is_idle = not lines or lines[-1]["kind"] in _IDLE_KINDS or lines[-1].get("text") == "q"
    last = _last_line(lines, "found", "rejected") if is_idle or stage is BalanceStage.MEASURING else {}
    checked = _last_line(lines, "live") if stage is BalanceStage.MEASURING else last
    faults = checked.get("faults") or _last_line(lines, "found").get("faults") or []
    x, y = _trajectory(lines, whole=stage is not BalanceStage.MEASURING)
    problem = next((str(line["problem"]) for line in lines[-2:] if line.get("problem")), "")
    turn = None if stage is BalanceStage.MEASURING else last.get("turn")
    advice, detail = _advice(stage, last, turn, output)
    # the advice and the question of the next turn follow the line on a forgotten turn
    forgotten = next((str(line["forgotten"]) for line in lines[-3:] if "forgotten" in line), "")
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
    if unknown := _unknown(last.get("faults") or ()):
        # an unmeasured quantity may still be wrong
        return "Measure again, with a larger swing", f"not known yet: {', '.join(unknown)}"
    return (text[:1].upper() + text[1:] or "Measure"), ""


def _cautions(turn: Mapping[str, Any]) -> Iterator[str]:
    """Cautions for the operator who makes a turn."""
    if len(turn["parts"]) > 1:
        yield _BACKLASH_NOTE
    if turn["swing_arcsec"] is not None:
        yield swing_text(turn["swing_arcsec"])


def _last_line(lines: Sequence[Mapping[str, Any]], *kinds: str) -> Mapping[str, Any]:
    return next((line for line in reversed(lines) if line["kind"] in kinds), {})


def _trajectory(
    lines: Sequence[Mapping[str, Any]], *, whole: bool
) -> tuple[list[float | None], list[float | None]]:
    """The last seconds of the trajectory, or all of the last measurement if `whole`, thinned."""
    first = 0
    if whole:
        indices = [k for k, line in enumerate(lines) if line["kind"] == "trajectory"]
        ends = [k for k, line in enumerate(lines) if line["kind"] in ("found", "rejected")]
        first = max((end for end in ends if indices and end < indices[-1]), default=0)
    pieces = [line for line in lines[first:] if line["kind"] == "trajectory"]
    pieces = pieces if whole else pieces[-_MAX_LIVE_PIECES:]
    x, y = ([value for piece in pieces for value in piece[axis]] for axis in ("x", "y"))
    step = max(1, len(x) // _MAX_TRAJECTORY_POINTS)
    return x[::step], y[::step]


def _print_checks(checks: Sequence[BalanceCheck], earlier_checks: Sequence[BalanceCheck]) -> None:
    """Print a table of the balance, with the checks before the last turn if there was one."""
    head = ("", "number", "now", *(["before"] if earlier_checks else []), "limit", "what it means")
    rows: list[list[str]] = []
    for k, check in enumerate(checks):
        row = [("go" if check.ok else "NO") if check.is_known else "?", check.name, _number(check)]
        if earlier_checks:
            row.append(_number(earlier_checks[k]))
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

    def report_trajectory(self, deflections: Deflections) -> None:
        """Report the deflections of some frames: nothing here, because the live view shows them."""

    def report_live(self, checks: Sequence[BalanceCheck]) -> None:
        """Report the balance while it is measured."""
        known = [check for check in checks[:2] if math.isfinite(check.value)]
        say("  ".join(f"{check.name} {check.value:+.3g} {check.unit}".rstrip() for check in known))

    def report_measurement(
        self,
        checks: Sequence[BalanceCheck],
        earlier_checks: Sequence[BalanceCheck],
        advice: Turn | Unreachable | None,
    ) -> None:
        """Report a sound measurement, the checks before the last turn (or empty), and the advised turn."""
        _print_checks(checks, earlier_checks)
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


class JsonReporter(Reporter):
    """Reports to a program: a JSON object on each line of stdout, answers line by line on stdin."""

    def report_trajectory(self, deflections: Deflections) -> None:
        step = max(1, len(deflections) // _POINTS_PER_LINE)
        x, y = deflections.shown_x[::step], deflections.shown_y[::step]
        print_json_line("trajectory", {"x": x.tolist(), "y": y.tolist()})

    def report_live(self, checks: Sequence[BalanceCheck]) -> None:
        print_json_line("live", {"faults": list(map(_check_values, checks))})

    def report_measurement(
        self,
        checks: Sequence[BalanceCheck],
        earlier_checks: Sequence[BalanceCheck],
        advice: Turn | Unreachable | None,
    ) -> None:
        turn = advice if isinstance(advice, Turn) else None
        faults, earlier_faults = list(map(_check_values, checks)), list(map(_check_values, earlier_checks))
        values = {"faults": faults, "before": earlier_faults, "text": turn_text(advice, checks)}
        print_json_line("found", {**values, "turn": _turn_values(turn)})

    def report_rejection(self, why: str, hint: str, back: Turn | None) -> None:
        text = turn_text(back, []) if back is not None else ""
        print_json_line("rejected", {"why": why, "hint": hint, "text": text, "turn": _turn_values(back)})

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


def _check_values(check: BalanceCheck) -> dict[str, Any]:
    return {**check._asdict(), "ok": check.ok if check.is_known else None}


def _turn_values(turn: Turn | None) -> dict[str, Any] | None:
    if turn is None:
        return None
    swing = turn.swing_arcsec if math.isfinite(turn.swing_arcsec) else None
    return {"weight": turn.weight, "parts": list(turn.parts), "why": turn.why, "swing_arcsec": swing}
