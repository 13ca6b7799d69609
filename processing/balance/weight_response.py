"""Response of one trimming weight: the effect of a turn and the play of its screw, learned from turns."""

import math
from collections.abc import Sequence

import numpy as np

from processing.arrays import Floats

MAX_PLAY = 0.6
"""Largest play of a screw that is considered, in turns."""
_GRID_PLAYS, _GRID_SLACKS = 25, 5
"""Numbers of plays, and of positions within each, that are considered."""
_PLAY_SCALE = 0.3
"""Play in turns by which the prior probability falls by a factor of e."""
_U_TURN, _U_RELATIVE = 0.015, 0.01
"""Standard uncertainty of a turn made by hand, in turns and relative to the turn."""
_U_SYSTEMATIC = 0.02
"""Systematic standard uncertainty of a state, in units of the limits."""


def _hand_variance(displacement: Floats) -> Floats:
    """Variance of a displacement by hand, in squared turns; 0 for a weight that its screw did not move."""
    return np.asarray(_U_TURN**2 * (displacement != 0) + (_U_RELATIVE * displacement) ** 2)


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
        self._line_information = np.zeros((2, 2))
        play = np.repeat(np.linspace(0.0, MAX_PLAY, _GRID_PLAYS), _GRID_SLACKS)
        # turns until a turn in the positive direction begins to move the weight
        self._slack = play * np.tile(np.linspace(0.0, 1.0, _GRID_SLACKS), _GRID_PLAYS)
        self._play = play
        self._log = -play / _PLAY_SCALE
        self._mean = np.tile(effect, (len(play), 1))
        self._variance = np.tile(u_effect**2, (len(play), 1))

    def without_turns(self) -> "WeightResponse":
        """The response before any turn was made."""
        return WeightResponse(self.nominal, self.u_nominal)

    def _displacement(self, turns: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Displacement (..., hypotheses) of the weight by turns in sequence, in turns, and the last slack."""
        slack = self._slack
        displacement = np.zeros(1)
        for turn in turns:
            turn = np.asarray(turn, dtype=np.float64)[..., None]
            forward = np.maximum(turn - slack, 0.0)
            backward = np.maximum(-turn - (self._play - slack), 0.0)
            displacement = displacement + forward - backward
            slack = np.clip(slack - turn, 0.0, self._play)
        return displacement, slack

    def _weights(self) -> Floats:
        weight = np.exp(self._log - self._log.max())
        return np.asarray(weight / weight.sum())

    def follow_turns(self, turns: Sequence[float]) -> None:
        """Account for turns without a measurement: only the screw's position within its play is updated."""
        _, self._slack = self._displacement([np.asarray(turn) for turn in turns])

    def log_evidence(self, turns: Sequence[float], step: Floats, u_step: Floats) -> float:
        """Log likelihood of these turns, given the change `step` (3,) of the state; NaN: not measured."""
        displacement, _ = self._displacement([np.asarray(turn) for turn in turns])
        measured, displacement = np.isfinite(step), displacement[:, None]
        size2 = np.sum(self._mean**2 + self._variance, axis=1, keepdims=True)
        hand = _hand_variance(displacement) * size2
        total = displacement**2 * self._variance + u_step**2 + 2.0 * _U_SYSTEMATIC**2 + hand
        residual = np.where(measured, step - displacement * self._mean, 0.0)
        log = -0.5 * np.sum(np.where(measured, residual**2 / total + np.log(total), 0.0), axis=1)
        return float(np.logaddexp.reduce(log + np.log(self._weights() + 1e-300)))

    def learn(self, turns: Sequence[float], step: Floats, u_step: Floats) -> None:
        """Learn from turns in sequence and the change (3,) of the state by them; NaN: not measured."""
        displacement, self._slack = self._displacement([np.asarray(turn) for turn in turns])
        measured = np.isfinite(step)
        displacement = displacement[:, None]
        other2 = u_step**2 + 2.0 * _U_SYSTEMATIC**2
        mean, variance = self._mean, self._variance
        size2 = mean**2 + variance
        # the hand's error is proportional to the effect, which the first pass estimates
        for _ in range(2):
            noise = other2 + _hand_variance(displacement) * np.sum(size2, axis=1, keepdims=True)
            total = displacement**2 * variance + noise
            gain = np.where(measured, variance * displacement / total, 0.0)
            residual = np.where(measured, step - displacement * mean, 0.0)
            learned = mean + gain * residual
            size2 = learned**2
        square = np.where(measured, residual**2 / total + np.log(total), 0.0)
        self._log = self._log - 0.5 * np.sum(square, axis=1)
        self._mean = learned
        self._variance = np.maximum(variance * (1.0 - gain * displacement), 1e-12)
        self.learned_turns += 1
        if measured[:2].all():
            self._line_information += np.outer(step[:2], step[:2]) / float(np.max(other2[:2]))

    def effect(self) -> tuple[Floats, Floats]:
        """Mean and standard uncertainty of the effect of one turn, without play."""
        mean, u = self._moments(np.ones((1, len(self._play))))
        return mean[0], u[0]

    def predict(self, turns: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Mean and standard uncertainty (..., 3) of the change by turns in sequence, each (...,)."""
        displacement, _ = self._displacement(turns)
        return self._moments(displacement)

    def _moments(self, displacement: Floats) -> tuple[Floats, Floats]:
        weight = self._weights()
        probable = weight > 1e-6
        weight, mean, variance = weight[probable], self._mean[probable], self._variance[probable]
        displacement = displacement[..., probable]
        mean_change = (displacement * weight) @ mean
        hand = _hand_variance(displacement) * weight
        square_change = (displacement**2 * weight) @ (mean**2 + variance) + hand @ mean**2
        u = np.sqrt(np.maximum(square_change - mean_change**2, 0.0))
        return mean_change, u

    def can_make(self, turns: Sequence[float], step: Floats, u_step: Floats) -> bool:
        """Whether these turns can have made a change of the state at all, by the expected effect."""
        largest = sum(abs(turn) for turn in turns) * (np.abs(self.nominal) + 6.0 * self.u_nominal)
        return not bool(np.any(np.abs(step) > largest + 6.0 * u_step + 0.5))

    def line(self) -> tuple[float, float]:
        """Angle in rad, from X towards Y, of the line along which the weight moves the rest position, and u.

        The play of the screw makes the size of an effect uncertain, not its line. The uncertainty is infinite
        if the weight has never moved visibly.
        """
        values, directions = np.linalg.eigh(self._line_information)
        direction = directions[:, 1] * (math.copysign(1.0, float(directions[:, 1] @ self.effect()[0][:2])))
        information = float(values[1])
        u_rad = 1.0 / math.sqrt(information) if information > 0 else math.inf
        return math.atan2(direction[1], direction[0]), u_rad
