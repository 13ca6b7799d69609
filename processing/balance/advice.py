"""Advice for balancing: which weight to turn, in which direction and how far.

The effect of each weight is a distribution, at first from its mass, thread and axis, then from the states
before and after earlier turns. A turn is chosen by its expected gain less its uncertainty.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from itertools import product
from typing import NamedTuple

import numpy as np

from processing.arrays import Flags, Floats
from processing.balance.balance import BalanceLimits, Doubt, Room, Turn, Unreachable
from processing.balance.weight_response import MAX_PLAY, WeightResponse

_MIN_SWING_ARCSEC = 10.0
"""Smallest amplitude of the next measurement that a turn must leave possible."""
_MIN_RELATIVE_EFFECT = 0.3
"""Smallest effect of a weight that is allowed for, relative to its expected effect."""
_U_UNKNOWN_EFFECT = 30.0
"""Standard uncertainty of the effect of one turn of an unknown weight, in limits."""
_MAX_UNKNOWN_TURNS = 1.0
_TEST_MOVE = 10.0
"""Expected move of a test turn, in limits."""
_TAKE_UP_TURNS = 0.75
"""Turns beyond the aim and back again, which take up the play of the screw."""
_TAKE_UP_COST = 0.3
"""Cost of a take-up, in squared limits."""
_MIN_GAIN = 0.2
"""Smallest expected gain of a turn, in squared limits."""
_VARIANCE_WEIGHT = 0.25
"""Weight of a turn's variance in its cost; less than 1, because a failed turn also gives information."""
_LINE_SIGMA = 2.0
"""Standard uncertainties by which a line may be wrong before balance is called unreachable."""
_MAX_U_KNOWN_LINE_RAD = 0.3
"""Largest uncertainty of the line of a weight that counts as known."""
_MAX_MOVE_RATIO = 4.0
"""Largest move of the rest position by one weight, relative to the distance from balance."""
_DOUBT_EVIDENCE = math.log(1e3)
"""Log evidence against a turn as stated above which the statement is doubted."""
_DIRECTION_EVIDENCE = 2.0
"""Log evidence for a turn as stated above which its direction is confirmed."""
_STATE_DRIFT_STD = 0.1
"""Standard deviation of a state's change, in limits, without any move of a weight."""


class WeightResponses:
    """Responses of the state (rest X in arcsec, rest Y in arcsec, height in m) to all weights, and advice.

    `nominal` has the expected effect of one turn of each weight and its standard uncertainty; None if nothing
    is known, and then test turns are advised first.
    """

    def __init__(self, nominal: Mapping[str, tuple[Floats, Floats] | None], limits: BalanceLimits) -> None:
        self._scale = np.array([limits.rest_arcsec, limits.rest_arcsec, limits.height_m])
        self._weights: dict[str, WeightResponse] = {}
        for name, expected in nominal.items():
            effect, u_effect = expected or (np.zeros(3), _U_UNKNOWN_EFFECT * self._scale)
            self._weights[name] = WeightResponse(
                np.asarray(effect, dtype=np.float64) / self._scale,
                np.asarray(u_effect, dtype=np.float64) / self._scale,
            )

    @property
    def learned_turns(self) -> dict[str, int]:
        """Number of turns of each weight from which its response was learned."""
        return {name: weight.learned_turns for name, weight in self._weights.items()}

    def learn(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> None:
        """Learn from the states before and after turns of one weight; NaN for an unknown component."""
        parts = _parts(turns)
        if any(parts):
            self._weights[weight].learn(parts, *self._step(before, after, u_state))

    def follow_turns(self, weight: str, turns: float | Sequence[float]) -> None:
        """Account for turns without usable states: only the screw's position within its play is updated."""
        self._weights[weight].follow_turns(_parts(turns))

    def can_make(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> bool:
        """Whether turns of one weight can have changed one state into the other."""
        step, u_step = self._step(before, after, u_state)
        return self._weights[weight].can_make(_parts(turns), np.nan_to_num(step), np.nan_to_num(u_step))

    def _step(self, before: Floats, after: Floats, u_state: Floats) -> tuple[Floats, Floats]:
        """Change of the state and its standard uncertainty, in limits."""
        return (after - before) / self._scale, math.sqrt(2.0) * u_state / self._scale

    def doubt(
        self, weight: str, turns: float | Sequence[float], before: Floats, after: Floats, u_state: Floats
    ) -> Doubt | None:
        """Doubt whether these turns of one weight were made; None if they explain the change clearly best.

        OPEN if another explanation is nearly as good.
        """
        response, parts = self._weights[weight], _parts(turns)
        step, u_step = self._step(before, after, u_state)
        log_stated = response.log_evidence(parts, step, u_step)
        log_stuck = response.log_evidence([0.0], step, np.hypot(u_step, _STATE_DRIFT_STD))
        # all turns reversed, or only the first of several, with those after it as stated
        reversed_turns = [[-part for part in parts], [-parts[0], *parts[1:]]]
        log_reversed = max(
            response.log_evidence(reversed_parts, step, u_step) for reversed_parts in reversed_turns
        )
        # the learned effect of a weight that never moved is zero: compare with the expected one, too
        log_expected = response.without_turns().log_evidence(parts, step, u_step)
        evidence, doubt = max(
            (log_stuck - min(log_stated, log_expected), Doubt.STUCK),
            (log_reversed - log_stated, Doubt.REVERSED),
        )
        if evidence > _DOUBT_EVIDENCE:
            return doubt
        return None if log_stated - log_reversed > _DIRECTION_EVIDENCE else Doubt.OPEN

    def relearn(
        self, weight: str, effects: Sequence[tuple[Sequence[float], Floats, Floats, Floats]] = ()
    ) -> None:
        """Forget the learned response of one weight and learn from the likeliest of `effects`.

        An effect is (turns, state before, state after, standard uncertainty).
        """
        response = self._weights[weight] = self._weights[weight].without_turns()
        if effects:
            turns = [(_parts(parts), *self._step(*states)) for parts, *states in effects]
            response.learn(*max(turns, key=lambda turn: response.log_evidence(*turn)))

    def without_weights(self, stuck: Collection[str]) -> "WeightResponses":
        """Copy with the other weights only."""
        others = copy(self)
        others._weights = {name: weight for name, weight in self._weights.items() if name not in stuck}
        return others

    def can_help(self, state: Floats, room: Room | None = None) -> bool:
        """Whether a turn of any weight is expected to improve the balance."""
        scaled_state = np.nan_to_num(state / self._scale)
        return any(self._best(name, state, scaled_state, room).gain > _MIN_GAIN for name in self._weights)

    def test_turn(self, weight: str, state: Floats, room: Room | None, why: str) -> Turn:
        """Best turn of one weight, or a test turn if the best one is too small to show whether it moves."""
        scaled_state = np.nan_to_num(state / self._scale)
        parts = self._best(weight, state, scaled_state, room).parts
        if not abs(sum(parts)) > MAX_PLAY:
            parts = self._test(weight, state, scaled_state, room)
        return self._turn(weight, parts, state, room, f"{why}; ")

    def effect(self, weight: str) -> tuple[Floats, Floats]:
        """Effect of one turn of a weight and its standard uncertainties, in (arcsec, arcsec, m)."""
        mean, u = self._weights[weight].effect()
        return mean * self._scale, u * self._scale

    def largest_turns(self, weight: str, state: Floats) -> float:
        """Largest sensible turn: it suffices even if the weight is weak and its screw has play."""
        effect = float(np.linalg.norm(self._weights[weight].nominal))
        distance = float(np.linalg.norm(np.nan_to_num(state / self._scale)))
        return (distance / (_MIN_RELATIVE_EFFECT * effect) if effect else _MAX_UNKNOWN_TURNS) + MAX_PLAY

    def advise(self, state: Floats, room: Room | None = None) -> Turn | Unreachable | None:
        """Next turn of one weight; None if the state is within the limits.

        A turn has the smallest expected squared distance from balance that the other weights cannot correct,
        uncertainty included, and leaves the spot on the sensor (`room`) with a margin of twice its
        uncertainty. A turn that suffices alone is preferred. Weights without a learned turn come first,
        because all later turns benefit; then the one whose turn is the most uncertain.
        """
        scaled_state = np.nan_to_num(state / self._scale)
        if np.all(np.abs(scaled_state) <= 1.0):
            return None
        if why := self._unreachable(scaled_state):
            return Unreachable(why)
        # the correction of a height within its limit would cost more by the tilt that it brings
        planned = scaled_state * [1.0, 1.0, float(abs(scaled_state[2]) > 0.7)]
        options = {name: self._best(name, state, planned, room) for name in self._weights}
        useful = {name: option for name, option in options.items() if option.gain > _MIN_GAIN}
        new = [name for name in useful if not self._weights[name].learned_turns]
        sufficient = [name for name, option in options.items() if option.suffices]
        # a weight that seems useless may act across the axis after which it is named
        untested = [
            name for name in self._tilting if not self._weights[name].learned_turns and name not in useful
        ]
        is_tilted = bool(np.any(np.abs(scaled_state[:2]) > 1.0))
        if not new and sufficient:
            name = max(sufficient, key=lambda name: options[name].gain)
        elif not useful or (is_tilted and untested and not new):
            least_known = min(
                self._weights,
                key=lambda name: (self._weights[name].learned_turns, self._lifts(name) == is_tilted),
            )
            name = untested[0] if is_tilted and untested else least_known
            return self._turn(name, self._test(name, state, planned, room), state, room, "a test turn: ")
        elif new:
            name = max(new, key=lambda name: (not self._lifts(name), useful[name].u_move))
        else:
            name = max(useful, key=lambda name: useful[name].u_move)
        return self._turn(name, options[name].parts, state, room, "")

    def _best(self, name: str, state: Floats, scaled_state: Floats, room: Room | None) -> "_Option":
        """Turn of one weight with the smallest expected cost."""
        weight = self._weights[name]
        max_turns = self.largest_turns(name, state)
        turns = np.linspace(-max_turns, max_turns, 301)
        take_up = np.sign(turns) * _TAKE_UP_TURNS
        first = np.round(np.concatenate([turns, turns + take_up]), 2)
        second = np.round(np.concatenate([np.zeros_like(turns), -take_up]), 2)
        move, u_move = weight.predict([first, second])
        remaining = scaled_state + move
        form = self._uncorrectable_form(name)
        cost = np.einsum("ni,ij,nj->n", remaining, form, remaining)
        cost = cost + _VARIANCE_WEIGHT * u_move**2 @ np.diag(form)
        cost += _TAKE_UP_COST * (second != 0) * bool(weight.learned_turns)
        is_allowed = self._stays_on_sensor(state, move, u_move, room)
        if not weight.learned_turns:
            # a first turn needs a take-up, as in `_test`, unless it is longer than the play
            is_allowed &= (second != 0) | (np.abs(first) > MAX_PLAY)
        is_allowed |= first == 0
        k = int(np.argmin(np.where(is_allowed, cost, np.inf)))
        gain = float(cost[first == 0].min() - cost[k])
        suffices = bool(np.all(np.abs(remaining[k]) + 2.0 * u_move[k] <= 0.9)) and first[k] != 0
        return _Option((float(first[k]), float(second[k])), gain, float(np.linalg.norm(u_move[k])), suffices)

    def _uncorrectable_form(self, name: str) -> Floats:
        """Quadratic form (3, 3): squared distance from balance that the other weights cannot correct."""
        others = [weight.effect() for other, weight in self._weights.items() if other != name]
        if not others:
            return np.eye(3)
        effects = np.column_stack([mean for mean, _ in others])
        variances = np.diag([float(u @ u) + 1e-9 for _, u in others])
        return np.asarray(np.eye(3) - effects @ np.linalg.solve(effects.T @ effects + variances, effects.T))

    def _stays_on_sensor(self, state: Floats, move: Floats, u_move: Floats, room: Room | None) -> Flags:
        """Whether each move (n, 3) leaves the spot on the sensor, or further from its edge than it is now."""
        if room is None:
            return np.ones(len(move), dtype=np.bool_)
        rest, u_rest = state[:2] + move[:, :2] * self._scale[:2], u_move[:, :2] * self._scale[:2]
        present = float(room.largest_swing_arcsec(state[:2], np.zeros(2)))
        return np.asarray(room.largest_swing_arcsec(rest, u_rest) >= min(_MIN_SWING_ARCSEC, present))

    @property
    def _tilting(self) -> list[str]:
        """Names of the weights that adjust the rest position."""
        return [name for name in self._weights if not self._lifts(name)]

    def _lifts(self, name: str) -> bool:
        """Whether a weight adjusts the height."""
        nominal = np.abs(self._weights[name].nominal)
        return bool(nominal[2] > max(nominal[0], nominal[1]))

    def _test(self, name: str, state: Floats, scaled_state: Floats, room: Room | None) -> tuple[float, float]:
        """Test turn and take-up that show the effect of a weight, as large as the sensor allows."""
        weight = self._weights[name]
        mean, u = weight.effect()
        test_turns = _TEST_MOVE / max(float(np.linalg.norm(np.hypot(mean, u))), 1e-9)
        max_turns = min(self.largest_turns(name, state), test_turns)
        max_turns += MAX_PLAY * min(1, weight.learned_turns)
        turns = np.round(np.linspace(-max_turns, max_turns, 40), 2)
        # without a take-up a first turn may be lost in the play of the screw
        second = np.zeros_like(turns) if weight.learned_turns else -np.sign(turns) * _TAKE_UP_TURNS
        move, u_move = weight.predict([turns - second, second])
        is_allowed = self._stays_on_sensor(state, move, u_move, room) & (turns != 0)
        if not is_allowed.any():
            return round(math.copysign(0.02, -float(scaled_state @ mean) or 1.0), 2), 0.0
        cost = np.sum((scaled_state + move) ** 2, axis=-1) - np.sum(u_move**2, axis=-1)
        k = int(np.argmin(np.where(is_allowed, cost, np.inf)))
        return round(float(turns[k] - second[k]), 2), float(second[k])

    def _turn(
        self, name: str, parts: tuple[float, float], state: Floats, room: Room | None, why: str
    ) -> Turn:
        weight = self._weights[name]
        move, u_move = weight.predict([np.array([part]) for part in parts])
        swing = math.inf
        if room is not None:
            rest, u_rest = state[:2] + move[0, :2] * self._scale[:2], u_move[0, :2] * self._scale[:2]
            swing = max(float(room.largest_swing_arcsec(rest, u_rest)), _MIN_SWING_ARCSEC)
        if count := weight.learned_turns:
            why += f"learned from {count} turn{'s' if count > 1 else ''}"
        else:
            known = weight.nominal.any()
            why += "from its mass and thread" if known else "nothing is known of this weight yet"
        return Turn(name, parts[0], why, parts[1], swing)

    def _unreachable(self, scaled_state: Floats) -> str:
        """Reason why the weights cannot balance the rest position; empty as long as they may."""
        names = self._tilting
        lines = np.array([self._weights[name].line() for name in names])
        if len(names) < 2 or not np.all(lines[:, 1] < _MAX_U_KNOWN_LINE_RAD):
            return ""
        angles_rad, u_rad = lines.T
        # the lines as measured, and turned against one another within their uncertainties
        error = _LINE_SIGMA * u_rad**2 / float(np.linalg.norm(u_rad))
        signs = product((-1.0, 0.0, 1.0), repeat=len(names))
        remaining = [self._remaining_rest(scaled_state, angles_rad + sign * error) for sign in signs]
        if not min(np.max(np.abs(rest)) for rest in remaining) > 1.0:
            return ""
        across = float(np.linalg.norm(self._remaining_rest(scaled_state, angles_rad))) * self._scale[0]
        angles = ", ".join(
            f"{name} {math.degrees(angle):.0f} deg" for name, angle in zip(names, angles_rad, strict=True)
        )
        return (
            f"the weights move the rest position along one line ({angles} from X towards Y): "
            f"{across:.0f} arcsec across it stay; move one of them to another side of the pendulum"
        )

    def _remaining_rest(self, scaled_state: Floats, angles_rad: Floats) -> Floats:
        """Rest position, in limits, that remains if weights move it along these lines (`_MAX_MOVE_RATIO`)."""
        from scipy.optimize import lsq_linear

        max_move = _MAX_MOVE_RATIO * max(float(np.linalg.norm(scaled_state[:2])), 1.0)
        directions = np.array([np.cos(angles_rad), np.sin(angles_rad)])
        moves = lsq_linear(directions, -scaled_state[:2], bounds=(-max_move, max_move)).x
        return np.asarray(scaled_state[:2] + directions @ moves)


class _Option(NamedTuple):
    """Best turn of one weight, with its take-up."""

    parts: tuple[float, float]
    gain: float
    """Expected gain, in squared limits."""
    u_move: float
    """Standard uncertainty of the move, in limits."""
    suffices: bool
    """Whether this turn alone leads to balance."""


def _parts(turns: float | Sequence[float]) -> tuple[float, ...]:
    return (float(turns),) if isinstance(turns, int | float) else tuple(float(part) for part in turns)
