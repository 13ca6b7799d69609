"""Response of one trimming weight: the effect of a turn and the play of its screw, learned from turns."""

import math
from collections.abc import Sequence

import numpy as np

from processing.arrays import Floats

_MAX_PLAY = 0.6
_GRID_PLAYS = 25
_GRID_SLACKS = 5
_USUAL_PLAY = 0.3
_U_TURN, _U_RELATIVE = 0.015, 0.01
"""Standard uncertainty of a turn made by hand, in turns and relative to the turn."""
_U_SYSTEMATIC = 0.02
"""Systematic standard uncertainty of a state, in limits."""


class WeightResponse:
    """Distribution of a weight's effect per turn (3,) and of the play of its screw.

    For each of a grid of plays, and of positions of the screw within its play (hypotheses), the effect has a
    normal distribution that every turn narrows; the probability of a hypothesis follows from how well it
    predicts the turns. Effects and states are in units of the limits.

    Parameters
    ----------
    effect, u_effect
        Expected effect of one turn before any was made, and its standard uncertainty, (3,).
    """

    def __init__(self, effect: Floats, u_effect: Floats) -> None:
        self.nominal, self.u_nominal = effect, u_effect
        self.learned_turns = 0
        self._seen = np.zeros((2, 2))
        play = np.repeat(np.linspace(0.0, _MAX_PLAY, _GRID_PLAYS), _GRID_SLACKS)
        # turns until a turn in the positive direction begins to move the weight
        self._slack = play * np.tile(np.linspace(0.0, 1.0, _GRID_SLACKS), _GRID_PLAYS)
        self._play = play
        self._log = -play / _USUAL_PLAY
        self._mean = np.tile(effect, (len(play), 1))
        self._variance = np.tile(u_effect**2, (len(play), 1))

    @property
    def largest_play(self) -> float:
        """Largest play considered, in turns."""
        return _MAX_PLAY

    def _displacement(self, parts: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Displacement (..., hypotheses) of the weight by turns in sequence, in turns, and the slack left."""
        slack = self._slack
        moved = np.zeros(1)
        for part in parts:
            turns = np.asarray(part, dtype=np.float64)[..., None]
            forward = np.maximum(turns - slack, 0.0)
            backward = np.maximum(-turns - (self._play - slack), 0.0)
            moved = moved + forward - backward
            slack = np.clip(slack - turns, 0.0, self._play)
        return moved, slack

    def _weights(self) -> Floats:
        weight = np.exp(self._log - self._log.max())
        return np.asarray(weight / weight.sum())

    def follow_turns(self, parts: Sequence[float]) -> None:
        """Account for turns without a measurement: only the screw's position within its play is updated."""
        _, self._slack = self._displacement([np.asarray(part) for part in parts])

    def log_evidence(self, parts: Sequence[float], step: Floats, u_step: Floats) -> float:
        """Log probability of a change `step` (3,) of the state if these turns made it; NaN: not measured."""
        moved, _ = self._displacement([np.asarray(part) for part in parts])
        seen, turns = np.isfinite(step), moved[:, None]
        hand2 = _U_TURN**2 * (turns != 0) + (_U_RELATIVE * turns) ** 2
        size2 = np.sum(self._mean**2 + self._variance, axis=1, keepdims=True)
        total = turns**2 * self._variance + u_step**2 + 2.0 * _U_SYSTEMATIC**2 + hand2 * size2
        left = np.where(seen, step - turns * self._mean, 0.0)
        log = -0.5 * np.sum(np.where(seen, left**2 / total + np.log(total), 0.0), axis=1)
        return float(np.logaddexp.reduce(log + np.log(self._weights() + 1e-300)))

    def learn(self, parts: Sequence[float], step: Floats, u_step: Floats) -> None:
        """Learn from turns in sequence and the change (3,) of the state by them; NaN: not measured."""
        moved, self._slack = self._displacement([np.asarray(part) for part in parts])
        seen = np.isfinite(step)
        turns = moved[:, None]
        # a weight that did not move has no error of the hand either
        u_turn2 = _U_TURN**2 * (turns != 0) + (_U_RELATIVE * turns) ** 2
        other = u_step**2 + 2.0 * _U_SYSTEMATIC**2
        mean, variance = self._mean, self._variance
        size2 = mean**2 + variance
        # the hand's error is proportional to the effect, which the first pass finds
        for _ in range(2):
            noise = other + u_turn2 * np.sum(size2, axis=1, keepdims=True)
            total = turns**2 * variance + noise
            gain = np.where(seen, variance * turns / total, 0.0)
            left = np.where(seen, step - turns * mean, 0.0)
            found = mean + gain * left
            size2 = found**2
        self._log = self._log - 0.5 * np.sum(np.where(seen, left**2 / total + np.log(total), 0.0), axis=1)
        self._mean = found
        self._variance = np.maximum(variance * (1.0 - gain * turns), 1e-12)
        self.learned_turns += 1
        if seen[:2].all():
            self._seen += np.outer(step[:2], step[:2]) / float(np.max(other[:2]))

    def effect(self) -> tuple[Floats, Floats]:
        """Mean and standard uncertainty of the effect of one turn, without play."""
        mean, u = self._moments(np.ones((1, len(self._play))))
        return mean[0], u[0]

    def predict(self, parts: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Mean and standard uncertainty (..., 3) of the change by turns in sequence, each (...,)."""
        moved, _ = self._displacement(parts)
        return self._moments(moved)

    def _moments(self, moved: Floats) -> tuple[Floats, Floats]:
        weight = self._weights()
        probable = weight > 1e-6
        weight, mean, variance = weight[probable], self._mean[probable], self._variance[probable]
        moved = moved[..., probable]
        first = (moved * weight) @ mean
        hand = (_U_TURN**2 * (moved != 0) + (_U_RELATIVE * moved) ** 2) * weight
        second = (moved**2 * weight) @ (mean**2 + variance) + hand @ mean**2
        u = np.sqrt(np.maximum(second - first**2, 0.0))
        return first, u

    def can_make(self, parts: Sequence[float], step: Floats, u_step: Floats) -> bool:
        """Whether these turns can have made a change of the state at all, by the expected effect."""
        most = sum(abs(part) for part in parts) * (np.abs(self.nominal) + 6.0 * self.u_nominal)
        return not bool(np.any(np.abs(step) > most + 6.0 * u_step + 0.5))

    def line(self) -> tuple[float, float]:
        """Angle in rad, from X towards Y, of the line along which the weight moves the rest position, and u.

        The play of the screw makes the size of an effect uncertain, not its line. The uncertainty is infinite
        if the weight has never moved visibly.
        """
        values, ways = np.linalg.eigh(self._seen)
        way = ways[:, 1] * (math.copysign(1.0, float(ways[:, 1] @ self.effect()[0][:2])))
        moved = float(values[1])
        return math.atan2(way[1], way[0]), 1.0 / math.sqrt(moved) if moved > 0 else math.inf
