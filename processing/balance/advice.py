"""Advice for balancing: which weight to turn, which way and how far.

A turn is as large as its expected gain less its doubt allows: what the weights do is a distribution, at first
from mass, thread and axis, then from the states before and after earlier turns.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from itertools import product
from typing import NamedTuple

import numpy as np

from processing.arrays import Flags, Floats
from processing.balance.balance import BalanceLimits, Doubt, Room, Turn, Unreachable
from processing.balance.weight_response import WeightResponse

_LEAST_SWING_ARCSEC = 10.0
"""Amplitude of the next look for which a turn must leave room."""
_WEAKEST = 0.3
"""The weakest weight that is reckoned with, relative to what is expected of it."""
_UNKNOWN_EFFECT = 30.0
"""Standard uncertainty of the effect of one turn of a weight of which nothing is known, in limits."""
_MOST_UNKNOWN_TURNS = 1.0
_TEST_MOVE = 10.0
"""Size of a turn that is made to learn: its expected move in limits."""
_TAKE_UP = 0.75
"""Turns too far and back again, which take the play out of the screw."""
_TAKE_UP_COST = 0.3
_NEEDED = 0.2
"""Least expected gain of a turn, in squared limits."""
_CAUTION = 0.25
"""Weight of a turn's variance beside its mean: what goes wrong is learned from, so that 1 would be timid."""
_SURE = 2.0
"""Standard uncertainties of a line that are believed in, before balance is called out of reach."""
_KNOWN_LINE_RAD = 0.3
"""Largest uncertainty of the line of a weight that counts as known."""
_STRETCH = 4.0
"""How far the weights together may push the rest position to and fro, relative to the way it has to go."""


_DOUBT = math.log(1e3)
"""Evidence for another story than that a turn was made as stated, from which on it is doubted."""
_SHOWN = 2.0
"""The same, for a turn to have been made as stated."""
_DRIFT = 0.1
"""Change of a state, in limits, that a weight which stands still may show."""


class WeightResponses:
    """What turns of the weights do to (rest X in arcsec, rest Y in arcsec, height in m), and what to turn.

    `nominal` gives what is expected of one turn of each weight: effects and their standard uncertainties, or
    None if nothing is known; test turns are advised first then.
    """

    def __init__(self, nominal: Mapping[str, tuple[Floats, Floats] | None], limits: BalanceLimits) -> None:
        self._scale = np.array([limits.rest_arcsec, limits.rest_arcsec, limits.height_m])
        self._weights: dict[str, WeightResponse] = {}
        for name, known in nominal.items():
            effect, u_effect = known if known is not None else (np.zeros(3), _UNKNOWN_EFFECT * self._scale)
            self._weights[name] = WeightResponse(
                np.asarray(effect, dtype=np.float64) / self._scale,
                np.asarray(u_effect, dtype=np.float64) / self._scale,
            )

    @property
    def pairs(self) -> dict[str, int]:
        """How many turns of each weight were learned from."""
        return {name: weight.pairs for name, weight in self._weights.items()}

    def learn(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> None:
        """Update with the states before and after turns of one weight; NaN for a component not known."""
        parts = _parts(turns)
        if any(parts):
            step, u_step = (after - before) / self._scale, math.sqrt(2.0) * u_state / self._scale
            self._weights[weight].learn(parts, step, u_step)

    def turned(self, weight: str, turns: float | Sequence[float]) -> None:
        """A weight was turned, and nothing can be learned from it: only the play of its screw is followed."""
        self._weights[weight].turned(_parts(turns))

    def can_make(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> bool:
        """Whether turns of one weight can have changed one state into the other."""
        step, u_step = (after - before) / self._scale, math.sqrt(2.0) * u_state / self._scale
        return self._weights[weight].can_make(_parts(turns), np.nan_to_num(step), np.nan_to_num(u_step))

    def doubt(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> Doubt | None:
        """What rather happened than these turns of one weight; None if they explain the change best."""
        known, parts = self._weights[weight], _parts(turns)
        step, u_step = (after - before) / self._scale, math.sqrt(2.0) * u_state / self._scale
        as_stated = known.log_evidence(parts, step, u_step)
        still = known.log_evidence([0.0], step, np.hypot(u_step, _DRIFT))
        # all of it, or only the first of several turns, the search back after it as stated
        other_ways = [[-part for part in parts], [-parts[0], *parts[1:]]]
        reversed_way = max(known.log_evidence(way, step, u_step) for way in other_ways)
        # one that never moved has taught that it has no effect
        drawn = WeightResponse(known.nominal, known.u_nominal).log_evidence(parts, step, u_step)
        gain, doubt = max(
            (still - min(as_stated, drawn), Doubt.STUCK), (reversed_way - as_stated, Doubt.REVERSED)
        )
        if gain > _DOUBT:
            return doubt
        return None if as_stated - reversed_way > _SHOWN else Doubt.OPEN

    def again(
        self, weight: str, pairs: Sequence[tuple[Sequence[float], Floats, Floats, Floats]] = ()
    ) -> None:
        """Forget what turns of one weight have taught; of these `pairs` the likeliest is learned from.

        A pair: turns, states before and after, standard uncertainty.
        """
        known = self._weights[weight]
        fresh = self._weights[weight] = WeightResponse(known.nominal, known.u_nominal)
        if pairs:
            turns = [
                (_parts(parts), (after - before) / self._scale, math.sqrt(2.0) * u / self._scale)
                for parts, before, after, u in pairs
            ]
            fresh.learn(*max(turns, key=lambda turn: fresh.log_evidence(*turn)))

    def without(self, stuck: Collection[str]) -> "WeightResponses":
        """The same with the other weights only."""
        found = copy(self)
        found._weights = {name: known for name, known in self._weights.items() if name not in stuck}
        return found

    def can_help(self, state: Floats, room: Room | None = None) -> bool:
        """Whether a turn of any weight is expected to lead nearer to balance."""
        wanted = np.nan_to_num(state / self._scale)
        return any(self._best(name, state, wanted, room).gain > _NEEDED for name in self._weights)

    def test_turn(self, weight: str, state: Floats, room: Room | None, why: str) -> Turn:
        """The turn of one weight that would be advised, or one as large, which shows whether it moves."""
        wanted = np.nan_to_num(state / self._scale)
        best = self._best(weight, state, wanted, room)
        known = self._weights[weight]
        shows = abs(sum(best.parts)) > known.largest_play
        parts = best.parts if shows else self._test(weight, state, wanted, room)
        return self._turn(weight, parts, state, room, f"{why}; ")

    def effect(self, weight: str) -> tuple[Floats, Floats]:
        """Effect of one turn of a weight and its standard uncertainties, in (arcsec, arcsec, m)."""
        mean, u = self._weights[weight].effect()
        return mean * self._scale, u * self._scale

    def largest_turns(self, weight: str, state: Floats) -> float:
        """The largest turn that can be sensible: enough even if the weight is weak and its screw has play."""
        known = self._weights[weight]
        size = float(np.linalg.norm(known.nominal))
        distance = float(np.linalg.norm(np.nan_to_num(state / self._scale)))
        return (distance / (_WEAKEST * size) if size else _MOST_UNKNOWN_TURNS) + known.largest_play

    def advise(self, state: Floats, room: Room | None = None) -> Turn | Unreachable | None:
        """The next turn of one weight; None if the state is within the limits.

        A turn has the smallest expected distance from balance after it, other weights corrected, doubt
        included; with twice its doubt it leaves the spot on the sensor (`room`). A weight of which nothing
        was learned comes first, because all later turns benefit; then the one whose turn is the most
        doubtful.
        """
        wanted = np.nan_to_num(state / self._scale)
        if np.all(np.abs(wanted) <= 1.0):
            return None
        if why := self._unreachable(wanted):
            return Unreachable(why)
        # a height within its limit is not worth the tilt that a turn for it brings
        planned = wanted * [1.0, 1.0, float(abs(wanted[2]) > 0.7)]
        options = {name: self._best(name, state, planned, room) for name in self._weights}
        needed = {name: found for name, found in options.items() if found.gain > _NEEDED}
        new = [name for name in needed if not self._weights[name].pairs]
        alone = [name for name, found in options.items() if found.suffices]
        # a weight that seems of no use may stand across the axis that it is named after
        idle = [name for name in self._tilting if not self._weights[name].pairs and name not in needed]
        tilted = bool(np.any(np.abs(wanted[:2]) > 1.0))
        if not new and alone:
            name = max(alone, key=lambda name: options[name].gain)
        elif not needed or (tilted and idle and not new):
            name = idle[0] if tilted and idle else self._least_known(wanted)
            return self._turn(name, self._test(name, state, planned, room), state, room, "a test turn: ")
        else:
            name = max(new or needed, key=lambda name: (not self._lifts(name), needed[name].doubt))
            if not new:
                name = max(needed, key=lambda name: needed[name].doubt)
        return self._turn(name, options[name].parts, state, room, "")

    def _best(self, name: str, state: Floats, wanted: Floats, room: Room | None) -> "_Option":
        """The turn of one weight with the smallest expected cost."""
        weight = self._weights[name]
        most = self.largest_turns(name, state)
        straight = np.linspace(-most, most, 301)
        zero = np.zeros_like(straight)
        way = np.sign(straight)
        first = np.concatenate([straight, straight + way * _TAKE_UP])
        then = np.concatenate([zero, -way * _TAKE_UP])
        first, then = np.round(first, 2), np.round(then, 2)
        move, u_move = weight.predict([first, then])
        left = wanted + move
        keep = self._uncorrected(name)
        cost = np.einsum("ni,ij,nj->n", left, keep, left) + _CAUTION * u_move**2 @ np.diag(keep)
        cost += _TAKE_UP_COST * (then != 0) * bool(weight.pairs)
        allowed = self._allowed(state, move, u_move, room)
        if not weight.pairs:
            # as in `_test`; a longer one is not lost
            allowed &= (then != 0) | (np.abs(first) > weight.largest_play)
        allowed |= first == 0
        k = int(np.argmin(np.where(allowed, cost, np.inf)))
        gain = float(cost[first == 0].min() - cost[k])
        suffices = bool(np.all(np.abs(left[k]) + 2.0 * u_move[k] <= 0.9)) and first[k] != 0
        return _Option((float(first[k]), float(then[k])), gain, float(np.linalg.norm(u_move[k])), suffices)

    def _uncorrected(self, name: str) -> Floats:
        """Form (3, 3) of what the other weights will leave of a state, each as far as it is known."""
        others = [weight.effect() for other, weight in self._weights.items() if other != name]
        if not others:
            return np.eye(3)
        effects = np.column_stack([mean for mean, _ in others])
        doubts = np.diag([float(u @ u) + 1e-9 for _, u in others])
        return np.asarray(np.eye(3) - effects @ np.linalg.solve(effects.T @ effects + doubts, effects.T))

    def _allowed(self, state: Floats, move: Floats, u_move: Floats, room: Room | None) -> Flags:
        """Which moves leave the spot on the sensor, or if it has no room now, leave it no less."""
        if room is None:
            return np.ones(len(move), dtype=np.bool_)
        rest, u_rest = state[:2] + move[:, :2] * self._scale[:2], u_move[:, :2] * self._scale[:2]
        now = float(room.largest_swing_arcsec(state[:2], np.zeros(2)))
        return np.asarray(room.largest_swing_arcsec(rest, u_rest) >= min(_LEAST_SWING_ARCSEC, now))

    @property
    def _tilting(self) -> list[str]:
        """The weights that are there for the rest position."""
        return [name for name in self._weights if not self._lifts(name)]

    def _lifts(self, name: str) -> bool:
        """Whether a weight is there for the height."""
        nominal = np.abs(self._weights[name].nominal)
        return bool(nominal[2] > max(nominal[0], nominal[1]))

    def _least_known(self, wanted: Floats) -> str:
        tilted = bool(np.any(np.abs(wanted[:2]) > 1.0))
        return min(self._weights, key=lambda name: (self._weights[name].pairs, self._lifts(name) == tilted))

    def _test(self, name: str, state: Floats, wanted: Floats, room: Room | None) -> tuple[float, float]:
        """A turn that shows what a weight does, as large as the sensor has room for."""
        weight = self._weights[name]
        mean, u = weight.effect()
        most = min(
            self.largest_turns(name, state), _TEST_MOVE / max(float(np.linalg.norm(np.hypot(mean, u))), 1e-9)
        )
        most += weight.largest_play * min(1, weight.pairs)
        turns = np.round(np.linspace(-most, most, 40), 2)
        # a first turn may be lost in the play of the screw, and shows nothing then
        then = np.zeros_like(turns) if weight.pairs else -np.sign(turns) * _TAKE_UP
        move, u_move = weight.predict([turns - then, then])
        allowed = self._allowed(state, move, u_move, room) & (turns != 0)
        if not allowed.any():
            return round(math.copysign(0.02, -float(wanted @ mean) or 1.0), 2), 0.0
        cost = np.sum((wanted + move) ** 2, axis=-1) - np.sum(u_move**2, axis=-1)
        k = int(np.argmin(np.where(allowed, cost, np.inf)))
        return round(float(turns[k] - then[k]), 2), float(then[k])

    def _turn(
        self, name: str, parts: tuple[float, float], state: Floats, room: Room | None, why: str
    ) -> Turn:
        weight = self._weights[name]
        move, u_move = weight.predict([np.array([part]) for part in parts])
        swing = math.inf
        if room is not None:
            rest, u_rest = state[:2] + move[0, :2] * self._scale[:2], u_move[0, :2] * self._scale[:2]
            swing = max(float(room.largest_swing_arcsec(rest, u_rest)), _LEAST_SWING_ARCSEC)
        count = weight.pairs
        why += (
            f"learned from {count} turn{'s' if count > 1 else ''}"
            if count
            else (
                "from its mass and thread" if weight.nominal.any() else "nothing is known of this weight yet"
            )
        )
        return Turn(name, parts[0], why, parts[1], swing)

    def _unreachable(self, wanted: Floats) -> str:
        """Why the weights that were turned cannot bring the rest position home; empty while it is open."""
        names = self._tilting
        lines = np.array([self._weights[name].line() for name in names])
        if len(names) < 2 or not np.all(lines[:, 1] < _KNOWN_LINE_RAD):
            return ""
        # the lines as they are found, and turned against one another as far as their doubt allows
        doubt = _SURE * lines[:, 1] ** 2 / float(np.linalg.norm(lines[:, 1]))
        ways = product((-1.0, 0.0, 1.0), repeat=len(names))
        left = [self._left(wanted, lines[:, 0] + way * doubt) for way in ways]
        if not min(np.max(np.abs(rest)) for rest in left) > 1.0:
            return ""
        across = float(np.linalg.norm(self._left(wanted, lines[:, 0]))) * self._scale[0]
        angles = ", ".join(
            f"{name} {math.degrees(angle):.0f} deg" for name, angle in zip(names, lines[:, 0], strict=True)
        )
        return (
            f"the weights move the rest position along one line ({angles} from X towards Y): "
            f"{across:.0f} arcsec across it stay; move one of them to another side of the pendulum"
        )

    def _left(self, wanted: Floats, angles_rad: Floats) -> Floats:
        """What stays of a rest position, in limits, when weights push it along these lines, within reason."""
        from scipy.optimize import lsq_linear

        most = _STRETCH * max(float(np.linalg.norm(wanted[:2])), 1.0)
        ways = np.array([np.cos(angles_rad), np.sin(angles_rad)])
        pushes = lsq_linear(ways, -wanted[:2], bounds=(-most, most)).x
        return np.asarray(wanted[:2] + ways @ pushes)


class _Option(NamedTuple):
    parts: tuple[float, float]
    gain: float
    doubt: float
    suffices: bool


def _parts(turns: float | Sequence[float]) -> tuple[float, ...]:
    return (float(turns),) if isinstance(turns, int | float) else tuple(float(part) for part in turns)
