"""Measurements of the balance: their checks, what they teach of the effect of turns, and advice.

The history of turns is a file with a line of JSON for each turn whose effect was learned.
"""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.balance import (
    Balance,
    BalanceCheck,
    Doubt,
    Room,
    Turn,
    Unreachable,
    WeightResponses,
    balance_checks,
    implausible,
    names_with_units,
)
from rig.instrument import WEIGHTS, mass_centre_height, nominal_effects, sensor_room
from rig.settings import Configuration
from rig.terminal import Table, answer, print_line, print_tables, say, with_uncertainty

Floats = NDArray[np.float64]


class TurnEffect(NamedTuple):
    """Turns of one weight, and the states before and after them.

    A state is the rest position in X and Y in arcsec, and the height of the mass centre in m.
    """

    utc: str
    weight: str
    parts: tuple[float, ...]
    """The turns in sequence, clockwise positive."""
    before: Floats
    after: Floats
    u: Floats
    """Standard uncertainties of either state."""


def _refusal(config: Configuration, responses: WeightResponses, effect: TurnEffect) -> str:
    """Why nothing can be learned from the effect of a turn; empty if it is sound."""
    radius_m = np.nan if config.pendulum is None else config.pendulum.ball_radius_m
    for state in (effect.before, effect.after):
        if reason := implausible(state, np.nan_to_num(effect.u), config.balance, radius_m, None):
            return reason
    if not responses.can_make(effect.weight, effect.parts, effect.before, effect.after, effect.u):
        change = effect.after - effect.before
        return (
            f"{_turns(effect.parts)} turns of weight {effect.weight} cannot have moved the rest position by"
            f" {np.hypot(*change[:2]):.0f} arcsec and the mass centre by {change[2] * 1e6:.0f} um;"
            " was something else touched?"
        )
    return ""


def _append(path: Path, **entry: object) -> None:
    """Add one line to the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in entry.items()}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"utc": now, **plain}) + "\n")


def append_turn(path: Path, effect: TurnEffect) -> None:
    """Add the effect of a turn to the file."""
    turns = effect.parts[0] if len(effect.parts) == 1 else list(effect.parts)
    _append(path, weight=effect.weight, turns=turns, before=effect.before, after=effect.after, u=effect.u)


def read_turns(path: Path) -> list[TurnEffect]:
    """The turns that were not forgotten; lines that cannot be read are reported and skipped."""
    effects: list[TurnEffect] = []
    if not path.exists():
        return effects
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            entry = json.loads(line)
            if entry.get("forgotten"):
                del effects[-1:]
            if entry.get("weight") not in WEIGHTS:
                continue
            turns = entry["turns"]
            parts = tuple(float(part) for part in (turns if isinstance(turns, list) else [turns]))
            states = [np.array(entry[key], dtype=np.float64) for key in ("before", "after", "u")]
            if any(state.shape != (3,) for state in states) or not np.all(np.isfinite(parts)):
                raise ValueError
            effects.append(TurnEffect(str(entry.get("utc", "")), entry["weight"], parts, *states))
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            # a line truncated by a power failure or edited by hand; the other lines are still valid
            say(f"{path}: line {number} cannot be read and is skipped")
    return effects


def forget_last_turn(path: Path) -> str:
    """Discard the last turn by a line in the file; returns a message."""
    effects = read_turns(path)
    if not effects:
        return "nothing learned yet"
    _append(path, forgotten=True)
    return f"the turn of weight {effects[-1].weight} is forgotten"


_HEAD = ("when", "weight", "turns", "X arcsec", "Y arcsec", "height um", "used")


def show_turns(config: Configuration, path: Path) -> None:
    """Print the turns of a history, which of them are used, and the learned effects of the weights."""
    responses = WeightResponses(nominal_effects(config), config.balance)
    rows, learned = [], []
    for effect in read_turns(path):
        refusal = _refusal(config, responses, effect)
        change = effect.after - effect.before
        numbers = [f"{change[0]:+.1f}", f"{change[1]:+.1f}", f"{change[2] * 1e6:+.1f}"]
        rows.append([effect.utc, effect.weight, _turns(effect.parts), *numbers, refusal or "yes"])
        if not refusal:
            responses.learn(effect.weight, effect.parts, effect.before, effect.after, np.nan_to_num(effect.u))
    for name, count in responses.learned_turns.items():
        if count:
            (x, y, height), (u_x, u_y, u_height) = responses.effect(name)
            learned.append(
                f"one turn of {name}: X {with_uncertainty(x, u_x, signed=True)}, "
                f"Y {with_uncertainty(y, u_y, signed=True)} arcsec, "
                f"height {with_uncertainty(1e6 * height, 1e6 * u_height, signed=True)} um"
            )
    answer(turns=[dict(zip(_HEAD, row, strict=True)) for row in rows], learned=learned)
    note = "" if rows else f"{path}: no turn of a weight is noted yet; rig balance asks for them"
    print_tables([Table("turns", "", _HEAD, rows, note)])
    for line in learned:
        print_line(line)


def _turns(parts: tuple[float, ...]) -> str:
    return " ".join(f"{part:+.2f}" for part in parts)


_MIN_GONE_FRACTION = 0.9
"""Smallest fraction of lost spots at which the spot counts as off the sensor."""
_SMALL_SWING_ARCSEC = 10.0
_SEARCH = (
    (0.5, "half of the last turn back, to see the spot again"),
    (0.0, "all of the last turn back, to see the spot again"),
    (1.5, "now the other way: the last turn may have been made the wrong way"),
    (2.0, "further that way, where the spot was if the last turn was made the wrong way"),
    (-0.5, "back beyond the beginning, to find the spot"),
    (2.5, "further the other way, to find the spot"),
    (-1.0, "further beyond the beginning, to find the spot"),
    (3.0, "further still the other way, to find the spot"),
)
"""Positions of the search, in units of the last turn, from where that turn began; and their reasons."""
_TEST_TURN_TEXTS = {
    Doubt.STUCK: "a test turn: it seems not to move; check that it follows its screw and is not at its stop",
    Doubt.OPEN: "a test turn",
    Doubt.REVERSED: "a test turn: it seems to have been turned the other way; clockwise is as one looks at "
    "the head of its screw",
}


class BalanceMeasurement(NamedTuple):
    """One measurement of the balance."""

    balance: Balance | None
    """The last balance; None if no swing was detected."""
    lost_fraction: float
    """Fraction of the frames with a lost or truncated spot."""
    sensor_shape: tuple[int, int]
    """Rows and columns of the frames."""


class LearnedTurns:
    """States, turns and learned responses; each turn whose effect was learned appends a line to `path`.

    `room` is the range of tilts on the sensor, known from the first measurement on. `checks` are those of the
    last sound measurement, `earlier_checks` those of the sound measurement before it (empty at first).
    """

    def __init__(self, config: Configuration, path: Path) -> None:
        self._config = config
        self._path = path
        self.limits = config.balance
        self.room: Room | None = None
        self.checks: list[BalanceCheck] = []
        self.earlier_checks: list[BalanceCheck] = []
        self._lost_fraction = 0.0
        self._noted_turns: list[tuple[str, tuple[float, ...]]] = []
        self._state: Floats | None = None
        self._doubts: dict[str, list[Doubt]] = {}
        self._effects: dict[str, TurnEffect] = {}
        self._search_steps, self._turns_to_loss = 0, 0.0
        self._relearn()

    def take(self, measurement: BalanceMeasurement) -> str:
        """Take a measurement; returns why it is rejected, empty if it is sound.

        After a rejected measurement the turns made are kept until the next sound one.
        """
        self._lost_fraction = measurement.lost_fraction
        self.room = sensor_room(self._config, measurement.sensor_shape)
        balance = measurement.balance
        if balance is None:
            return f"no swing was seen in {self.limits.seconds:g} s"
        if self._lost_fraction > self._config.preflight.max_lost_fraction:
            return (
                f"{100 * self._lost_fraction:.0f} % of the spots were lost or cut: the spot leaves the"
                " sensor, or something covers it"
            )
        height_m, u_height_m = mass_centre_height(self._config, balance)
        checks = balance_checks(balance, (height_m, u_height_m), self.limits)
        state = np.array([checks[0].value, checks[1].value, height_m])
        u_state = np.array([checks[0].u_value, checks[1].u_value, u_height_m])
        radius_m = np.nan if self._config.pendulum is None else self._config.pendulum.ball_radius_m
        if reason := implausible(state, np.nan_to_num(u_state), self.limits, radius_m, self.room):
            return reason
        self.earlier_checks, self.checks = self.checks, checks
        self._learn(balance, state, u_state)
        self._noted_turns, self._state = [], state
        self._search_steps = 0
        return ""

    def advice(self) -> Turn | Unreachable | None:
        """The next turn after a sound measurement; None if all values are within limits.

        A turn with another effect than expected is repeated, to test whether the weight is stuck or was
        turned the other way. A weight that twice did not move is left out.
        """
        assert self._state is not None
        state, room = self._state, self.room
        stuck = {name for name, doubts in self._doubts.items() if doubts.count(Doubt.STUCK) > 1}
        usable = self.responses.without_weights(stuck)
        advice = usable.advise(state, room)
        if advice is None:
            return None
        if stuck and not usable.can_help(state, room):
            return Unreachable(
                f"weight {' and '.join(sorted(stuck))} does not move: two turns of it changed nothing; check "
                "that it is free, not at its stop and not slipping on its screw, then turn it again"
            )
        doubted = [
            (name, doubts[-1]) for name, doubts in self._doubts.items() if name not in stuck and doubts
        ]
        if doubted:
            name, doubt = doubted[0]
            return usable.test_turn(name, state, room, _TEST_TURN_TEXTS[doubt])
        return advice

    def way_back(self) -> Turn | None:
        """A turn back after a measurement without a balance: part of the last turn; None if there was none.

        While the spot is off the sensor it is a search: half of the turn back, all of it, then as far the
        other way, in case the turn was made in the wrong direction, and so on in widening steps.
        """
        if not self._noted_turns:
            return None
        weight = self._noted_turns[-1][0]
        net = sum(sum(parts) for name, parts in self._noted_turns if name == weight)
        reason = _SEARCH[0][1]
        back = round(-0.5 * net, 2)
        if self.spot_is_gone or self._search_steps:
            if self._search_steps == 0:
                self._turns_to_loss = net
            if self._search_steps >= len(_SEARCH):
                return None
            position, reason = _SEARCH[self._search_steps]
            self._search_steps += 1
            back = round(position * self._turns_to_loss - net, 2)
        return Turn(weight, back, reason, swing_arcsec=_SMALL_SWING_ARCSEC) if back else None

    @property
    def spot_is_gone(self) -> bool:
        """Whether nearly all spots are lost after a turn, when a smaller swing would not help."""
        return bool(self._noted_turns) and self._lost_fraction > _MIN_GONE_FRACTION

    def note_turns(self, weight: str, parts: Sequence[float]) -> None:
        """Store the turns made, in sequence; their effect is learned from the next sound measurement."""
        self._noted_turns.append((weight, tuple(parts)))

    def forget(self) -> str:
        """Discard the last learned turn; returns a message."""
        message = forget_last_turn(self._path)
        self._relearn()
        return message

    def _learn(self, balance: Balance, state: Floats, u_state: Floats) -> None:
        weights = {name for name, _ in self._noted_turns}
        if not weights or self._state is None:
            numbers = {key: getattr(balance, name) for name, key in names_with_units(balance.unit).items()}
            _append(self._path, state=state, balance=numbers)
            return
        parts = tuple(part for _, turns in self._noted_turns for part in turns)
        weight = next(iter(weights))
        effect = TurnEffect("", weight, parts, self._state, state, np.nan_to_num(u_state))
        refusal = (
            f"weights {' and '.join(sorted(weights))} were turned between two measurements"
            if len(weights) > 1
            else _refusal(self._config, self.responses, effect)
        )
        if refusal:
            say(f"nothing is learned from this turn: {refusal}")
            for name, turns in self._noted_turns:
                self.responses.follow_turns(name, turns)
            return
        if self._doubts_turn(effect):
            return
        self.responses.learn(weight, parts, effect.before, state, effect.u)
        self._effects[weight] = effect
        append_turn(self._path, effect)

    def _doubts_turn(self, effect: TurnEffect) -> bool:
        """Whether a turn contradicts what was stated; it is then reported, and not learned from."""
        weight, responses = effect.weight, self.responses
        doubts = self._doubts.setdefault(weight, [])
        doubt = responses.doubt(weight, effect.parts, effect.before, effect.after, np.nan_to_num(effect.u))
        if doubt is Doubt.OPEN and self._search_steps:
            # an advised turn, made as advised, would have left the spot on the sensor
            doubt = Doubt.REVERSED
        if doubt is None and doubts:
            say(f"weight {weight} now moves as stated: the previous turn was not as stated")
            doubts.clear()
        if doubt is None or (doubt is Doubt.OPEN and not doubts):
            return False
        if doubt is Doubt.OPEN:
            responses.follow_turns(weight, effect.parts)
            return True
        say(f"nothing is learned from this turn: it looks as if weight {weight} {doubt}")
        effects = [known for known in (self._effects.get(weight), effect) if known is not None]
        if doubt is Doubt.REVERSED and (doubts[-1:] == [doubt] or responses.learned_turns[weight] == 1):
            # either this turn or the earlier learning is wrong
            say(f"weight {weight} may do the opposite of what was learned; what was learned is discarded")
            data = [(known.parts, known.before, known.after, np.nan_to_num(known.u)) for known in effects]
            responses.relearn(weight, data if responses.learned_turns[weight] == 1 else data[-1:])
            doubts.clear()
        else:
            responses.follow_turns(weight, effect.parts)
        doubts.append(doubt)
        return True

    def _relearn(self) -> None:
        self.responses = WeightResponses(nominal_effects(self._config), self.limits)
        count = 0
        for effect in read_turns(self._path):
            if refusal := _refusal(self._config, self.responses, effect):
                say(f"{self._path}: the turn of {effect.utc} is not used: {refusal}")
                continue
            self.responses.learn(
                effect.weight, effect.parts, effect.before, effect.after, np.nan_to_num(effect.u)
            )
            count += 1
        if count:
            say(f"{self._path}: turns that are used: {count}")
