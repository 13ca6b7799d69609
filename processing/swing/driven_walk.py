"""How far a drive moves the pendulum from one half-cycle to the next, learned from the turning points.

What the ground does at the pendulum's frequency adds independent steps of one variance to the amplitude and
to the phase times the amplitude. They show as differences of both from their predictions, larger than the
uncertainties of measurement and prediction explain. A rest position that wanders makes the amplitudes
differ, too, but in turns up and down, as the sides of the turning points.
"""

import math
from typing import NamedTuple

from processing.swing.prediction import SLOPE_WANDER

_MEMORY = 32
_AT_FIRST = 16
_BEGINS = 4.0
"""Sum of the running means of both squares, in units of their variances, above which there is a drive."""
_BEGINS_AS_REST_MOVES = 3.4
"""The same where the rest position seems to move: by chance the sum is 2, with a deviation of 0.35."""
_LARGEST = 4.0
"""Largest difference that counts later, in standard deviations."""
_OFFSET = 0.65
"""Running mean of the differences, in standard deviations (it scatters by 0.18), above which the motion
without the drive is predicted wrongly."""
_IN_TURNS = 0.3
"""Part of the amplitudes' squares that stands in turns, above which they say nothing of a drive."""
_CLIP = 32.0
"""Largest square that counts; so large that one knock alone is no drive."""
_NEGLIGIBLE = 0.2
"""Step, in units of an amplitude's uncertainty with all else known, that the prediction allows for anyway."""


_AMPLITUDE_WITHIN, _TIME_WITHIN, _CENTRE_WITHIN = 0.35, 0.37, 0.33
"""What a white drive does within a half-cycle, as errors of a fit of amplitude, phase and centre to its
samples about a turning point, in steps. Of the amplitude's, half is the centre's, which is taken with it.
The centre's own is relative to what white noise of the same resolution does to it."""


_DRIFT_PART = 0.05
_MOST_DRIFT_NOISE = 1e9


class Within(NamedTuple):
    """Factors on uncertainties for what the drive does within a half-cycle, which looks like noise."""

    samples: float = 1.0
    amplitude: float = 1.0
    time: float = 1.0


class DrivenWalk:
    """Variance of the steps; 0 while none are seen. A `variance` that is known is not learned."""

    def __init__(self, variance: float = 0.0) -> None:
        self.variance = variance
        self._known = variance > 0.0
        self._means = [1.0, 1.0]
        self._offsets = [0.0, 0.0]
        self._in_turns = self._before = 0.0
        self._count = 0

    def offset(self) -> bool:
        """Whether the differences have come to lie on one side, which no drive does for long."""
        if max(abs(one) for one in self._offsets) < _OFFSET:
            return False
        self._offsets = [0.0, 0.0]
        return True

    def within(self, resolution: float) -> Within:
        """The factors, for an uncertainty of the amplitude with all else known."""
        if self.variance == 0.0:
            return Within()
        relative = self.variance / resolution**2
        samples, amplitude, time = (
            math.sqrt(1.0 + part**2 * relative) for part in (_CENTRE_WITHIN, _AMPLITUDE_WITHIN, _TIME_WITHIN)
        )
        return Within(samples, amplitude, time)

    def most_drift_noise(self, resolution: float) -> float:
        """Largest variance of the change of the drift, in that of `prediction`, which is a part of the steps.

        The rest position, too, seems to move with a drive; more would let it take up what amplitude and
        phase do.
        """
        if self.variance == 0.0 or self._wandering:
            return _MOST_DRIFT_NOISE
        return max(1.0, self.variance * (_DRIFT_PART / (SLOPE_WANDER * resolution)) ** 2)

    @property
    def _wandering(self) -> bool:
        """Whether amplitudes differ in turns, as with a rest position that wanders."""
        return self._in_turns > _IN_TURNS * self._means[0]

    @property
    def excess(self) -> float:
        """How many times as large as their variances the squares have been."""
        return max(1.0, 0.5 * sum(self._means))

    def learn(
        self,
        differences: tuple[float, float],
        variances: tuple[float, float],
        resolution: float,
        rest_moves: bool,
    ) -> bool:
        """Take in one more half-cycle; True if a drive begins to be seen with it.

        Parameters
        ----------
        differences
            Measured minus predicted amplitude, and the same of the time, times amplitude and frequency.
        variances
            Their expected variances, with the present steps.
        resolution
            Uncertainty of the amplitude if all else were known; the unit of all is that of the deflection.
        rest_moves
            Whether the rest position seems to move as well, to which an unseen drive leads.
        """
        squares = [d * d for d in differences]
        ratios = [min(s / v, _CLIP) for s, v in zip(squares, variances, strict=True)]
        for k in (0, 1):
            self._means[k] += (ratios[k] - self._means[k]) / _AT_FIRST
        now = math.copysign(math.sqrt(ratios[0]), differences[0])
        self._in_turns += (-now * self._before - self._in_turns) / _AT_FIRST
        self._before = now
        if self._known:
            return False
        if self.variance == 0.0:
            self._offsets = [0.0, 0.0]
            together = sum(self._means)
            if together < (_BEGINS_AS_REST_MOVES if rest_moves else _BEGINS) or self._wandering:
                return False
            self._count = 2
            self.variance = max(0.5 * (sum(squares) - sum(variances)), resolution**2)
            return True
        self._count = min(self._count + 1, _MEMORY)
        found = self.variance
        for k in (0, 1):
            deviate = max(-_LARGEST, min(differences[k] / math.sqrt(variances[k]), _LARGEST))
            square = (deviate - self._offsets[k]) ** 2 - (max(self._in_turns, 0.0) if k == 0 else 0.0)
            found += 0.5 * variances[k] * (square - 1.0)
            self._offsets[k] += (deviate - self._offsets[k]) / _AT_FIRST
        self.variance += (found - self.variance) / self._count
        if self.variance < (_NEGLIGIBLE * resolution) ** 2:
            self.variance = 0.0
            self._means = [1.0, 1.0]
        return False
