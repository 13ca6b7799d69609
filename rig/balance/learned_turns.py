"""Judges every measurement, learns the effect of turns from those that are sound, and advises."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.balance import (
    Balance,
    Doubt,
    Fault,
    Room,
    Turn,
    Unreachable,
    WeightResponses,
    find_faults,
    implausible,
    names_with_units,
)
from rig.balance import history
from rig.instrument import height_of, nominal_effects, sensor_room
from rig.presentation import say
from rig.settings import Configuration

Floats = NDArray[np.float64]

_GONE = 0.9
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
"""Places of the search in parts of the last turn, from where it began."""
_TESTS = {
    Doubt.STUCK: "a test turn: it seems not to move; check that it follows its screw and is not at its stop",
    Doubt.OPEN: "a test turn",
    Doubt.REVERSED: "a test turn: it seems to have been turned the other way; clockwise is as one looks at "
    "the head of its screw",
}


class BalanceMeasurement(NamedTuple):
    """One measurement: the last balance (None: no swing seen), lost and cut spots, (ny, nx) of the sensor."""

    balance: Balance | None
    lost_fraction: float
    sensor_shape: tuple[int, int]


class LearnedTurns:
    """States, turns and learned responses; each sound measurement appends a line of JSON to `path`.

    `room` is the sensor's, known from the first look on.
    """

    def __init__(self, config: Configuration, path: Path) -> None:
        self._config = config
        self._path = path
        self.limits = config.balance
        self.room: Room | None = None
        self.faults: list[Fault] = []
        self.before: list[Fault] = []
        self._lost_fraction = 0.0
        self._turned: list[tuple[str, tuple[float, ...]]] = []
        self._state: Floats | None = None
        self._doubts: dict[str, list[Doubt]] = {}
        self._pairs: dict[str, history.Pair] = {}
        self._searched, self._lost_after = 0, 0.0
        self._relearn()

    def take(self, look: BalanceMeasurement) -> str:
        """Take a measurement; returns why it is rejected, empty if it is sound.

        A sound one sets `faults`, and `before` to those before the last turn (empty at first). After a
        rejected one the turns made are kept, and learned from at the next sound one.
        """
        self._lost_fraction = look.lost_fraction
        self.room = sensor_room(self._config, look.sensor_shape)
        balance = look.balance
        if balance is None:
            return f"no swing was seen in {self.limits.seconds:g} s"
        if look.lost_fraction > self._config.preflight.max_lost_fraction:
            return (
                f"{100 * look.lost_fraction:.0f} % of the spots were lost or cut: the spot leaves the sensor,"
                " or something covers it"
            )
        height_m, u_height_m = height_of(self._config, balance)
        faults = find_faults(balance, (height_m, u_height_m), self.limits)
        state = np.array([faults[0].value, faults[1].value, height_m])
        u_state = np.array([faults[0].u_value, faults[1].u_value, u_height_m])
        radius_m = np.nan if self._config.pendulum is None else self._config.pendulum.ball_radius_m
        if why := implausible(state, np.nan_to_num(u_state), self.limits, radius_m, self.room):
            return why
        self.before, self.faults = self.faults, faults
        self._learn(balance, state, u_state)
        self._turned, self._state = [], state
        self._searched = 0
        return ""

    def advice(self) -> Turn | Unreachable | None:
        """The next turn after a sound measurement; None if all values are within limits.

        A turn that showed something else than was stated is repeated, which tests whether the weight does not
        move or was turned the other way. One that twice did not move is left out.
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
            return usable.test_turn(name, state, room, _TESTS[doubt])
        return advice

    def way_back(self) -> Turn | None:
        """After a look that showed nothing: part of the last turn back; None if there was none.

        While the spot is gone, a search: half of the turn back, all of it, then as far the other way, as one
        that was turned the wrong way needs it, and so on in widening steps.
        """
        if not self._turned:
            return None
        weight = self._turned[-1][0]
        net = sum(sum(parts) for name, parts in self._turned if name == weight)
        why = "half of the last turn back, to see the spot again"
        back = round(-0.5 * net, 2)
        if self.spot_is_gone or self._searched:
            if self._searched == 0:
                self._lost_after = net
            if self._searched >= len(_SEARCH):
                return None
            place, why = _SEARCH[self._searched]
            self._searched += 1
            back = round(place * self._lost_after - net, 2)
        return Turn(weight, back, why, swing_arcsec=_SMALL_SWING_ARCSEC) if back else None

    @property
    def spot_is_gone(self) -> bool:
        """Whether the last look saw next to nothing, after a turn: a smaller swing would not help."""
        return bool(self._turned) and self._lost_fraction > _GONE

    def turned(self, weight: str, parts: Sequence[float]) -> None:
        """Store the turns made, in sequence; their effect is learned from the next sound measurement."""
        self._turned.append((weight, tuple(parts)))

    def forget(self) -> None:
        """Take the last learned turn out of the history."""
        say(history.forget_last(self._path))
        self._relearn()

    def _learn(self, balance: Balance, state: Floats, u_state: Floats) -> None:
        weights = {name for name, _ in self._turned}
        if not weights or self._state is None:
            numbers = {key: getattr(balance, name) for name, key in names_with_units(balance.unit).items()}
            history.append(self._path, state=state, balance=numbers)
            return
        parts = tuple(part for _, turns in self._turned for part in turns)
        weight = next(iter(weights))
        pair = history.Pair("", weight, parts, self._state, state, np.nan_to_num(u_state))
        why = (
            f"weights {' and '.join(sorted(weights))} were turned between two measurements"
            if len(weights) > 1
            else history.refusal(self._config, self.responses, pair)
        )
        if why:
            say(f"nothing is learned from this turn: {why}")
            for name, turns in self._turned:
                self.responses.turned(name, turns)
            return
        if self._doubts_turn(pair):
            return
        self.responses.learn(weight, parts, pair.before, state, pair.u)
        self._pairs[weight] = pair
        history.append_pair(self._path, pair)

    def _doubts_turn(self, pair: history.Pair) -> bool:
        """Whether a turn shows something else than was stated, which is said, and not learned from."""
        weight, responses = pair.weight, self.responses
        doubts = self._doubts.setdefault(weight, [])
        doubt = responses.doubt(weight, pair.parts, pair.before, pair.after, np.nan_to_num(pair.u))
        if doubt is Doubt.OPEN and self._searched:
            # a turn that was advised leaves the spot on the sensor, if it is made as advised
            doubt = Doubt.REVERSED
        if doubt is None and doubts:
            say(f"weight {weight} now moves as stated: the previous turn was not as stated")
            doubts.clear()
        if doubt is None or (doubt is Doubt.OPEN and not doubts):
            return False
        if doubt is Doubt.OPEN:
            responses.turned(weight, pair.parts)
            return True
        say(f"nothing is learned from this turn: it looks as if weight {weight} {doubt}")
        told = [each for each in (self._pairs.get(weight), pair) if each is not None]
        if doubt is Doubt.REVERSED and (doubts[-1:] == [doubt] or responses.pairs[weight] == 1):
            # this turn, or what was learned before it
            say(f"weight {weight} may do the opposite of what was learned; what was learned is discarded")
            seen = [(each.parts, each.before, each.after, np.nan_to_num(each.u)) for each in told]
            responses.relearn(weight, seen if responses.pairs[weight] == 1 else seen[-1:])
            doubts.clear()
        else:
            responses.turned(weight, pair.parts)
        doubts.append(doubt)
        return True

    def _relearn(self) -> None:
        self.responses = WeightResponses(nominal_effects(self._config), self.limits)
        used = 0
        for pair in history.read(self._path):
            if why := history.refusal(self._config, self.responses, pair):
                say(f"{self._path}: the turn of {pair.utc} is not used: {why}")
                continue
            self.responses.learn(pair.weight, pair.parts, pair.before, pair.after, np.nan_to_num(pair.u))
            used += 1
        if used:
            say(f"{self._path}: {used} turns of earlier sessions are used")
