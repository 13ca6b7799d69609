"""The history file of turns and their effects: a line of JSON for each checked measurement."""

import datetime
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.balance import WeightResponses, implausible
from rig.instrument import WEIGHTS, nominal_effects
from rig.presentation import Table, answer, print_line, print_tables, say
from rig.settings import Configuration

Floats = NDArray[np.float64]


class TurnEffect(NamedTuple):
    """Turns of one weight in sequence, and the states (arcsec, arcsec, m) before and after them, with u."""

    utc: str
    weight: str
    parts: tuple[float, ...]
    before: Floats
    after: Floats
    u: Floats


def refusal(config: Configuration, responses: WeightResponses, pair: TurnEffect) -> str:
    """Why nothing can be learned from the effect of a turn; empty if it is sound."""
    radius_m = np.nan if config.pendulum is None else config.pendulum.ball_radius_m
    for state in (pair.before, pair.after):
        if why := implausible(state, np.nan_to_num(pair.u), config.balance, radius_m, None):
            return why
    if not responses.can_make(pair.weight, pair.parts, pair.before, pair.after, pair.u):
        moved = np.hypot(*(pair.after - pair.before)[:2])
        return (
            f"{_turns(pair.parts)} turns of weight {pair.weight} cannot have moved the rest position by"
            f" {moved:.0f} arcsec and the mass centre by {(pair.after - pair.before)[2] * 1e6:.0f} um;"
            " was something else touched?"
        )
    return ""


def append(path: Path, **entry: object) -> None:
    """Add one line to the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in entry.items()}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"utc": now, **plain}) + "\n")


def append_pair(path: Path, pair: TurnEffect) -> None:
    """Add the effect of a turn to the file."""
    turns = pair.parts[0] if len(pair.parts) == 1 else list(pair.parts)
    append(path, weight=pair.weight, turns=turns, before=pair.before, after=pair.after, u=pair.u)


def read(path: Path) -> list[TurnEffect]:
    """The turns that were not forgotten; lines that cannot be read are reported and skipped."""
    pairs: list[TurnEffect] = []
    if not path.exists():
        return pairs
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            entry = json.loads(line)
            if entry.get("forgotten"):
                del pairs[-1:]
            if entry.get("weight") not in WEIGHTS:
                continue
            turns = entry["turns"]
            parts = tuple(float(part) for part in (turns if isinstance(turns, list) else [turns]))
            states = [np.array(entry[key], dtype=np.float64) for key in ("before", "after", "u")]
            if any(state.shape != (3,) for state in states) or not np.all(np.isfinite(parts)):
                raise ValueError
            pairs.append(TurnEffect(str(entry.get("utc", "")), entry["weight"], parts, *states))
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            # a line truncated by a power failure or edited by hand; the other lines are still valid
            say(f"{path}: line {number} cannot be read and is skipped")
    return pairs


def forget_last(path: Path) -> str:
    """Discard the last turn by a line in the file; returns a message."""
    pairs = read(path)
    if not pairs:
        return "nothing learned yet"
    append(path, forgotten=True)
    return f"the turn of weight {pairs[-1].weight} is forgotten"


_HEAD = ("when", "weight", "turns", "X arcsec", "Y arcsec", "height um", "used")


def show(config: Configuration, path: Path) -> None:
    """Print the turns of a history, which of them are used, and the learned effects of the weights."""
    responses = WeightResponses(nominal_effects(config), config.balance)
    rows, learned = [], []
    for pair in read(path):
        why = refusal(config, responses, pair)
        change = pair.after - pair.before
        numbers = [f"{change[0]:+.1f}", f"{change[1]:+.1f}", f"{change[2] * 1e6:+.1f}"]
        rows.append([pair.utc, pair.weight, _turns(pair.parts), *numbers, why or "yes"])
        if not why:
            responses.learn(pair.weight, pair.parts, pair.before, pair.after, np.nan_to_num(pair.u))
    for name, count in responses.pairs.items():
        if count:
            (x, y, height), (u_x, u_y, u_height) = responses.effect(name)
            learned.append(
                f"one turn of {name}: X {x:+.1f} ± {u_x:.1f}, Y {y:+.1f} ± {u_y:.1f} arcsec,"
                f" height {height * 1e6:+.2f} ± {u_height * 1e6:.2f} um"
            )
    answer(turns=[dict(zip(_HEAD, row, strict=True)) for row in rows], learned=learned)
    print_tables([Table("turns", "", _HEAD, rows, _HEAD, rows)])
    for line in learned:
        print_line(line)


def _turns(parts: tuple[float, ...]) -> str:
    return " ".join(f"{part:+.2f}" for part in parts)
