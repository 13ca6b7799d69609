"""What a reference spot says of the beam's motion so far: the causal counterpart of `reference_beam`.

Along each axis the motion is taken for a random walk under white noise: of both sizes the walk's is learned
from the differences of the place over some frames, the noise is the tracker's. Kalman's filter follows it; a
reference that only makes noise is followed ever more slowly, to its mean. While it is lost its last known
place holds, which of a walk is the best guess, and the uncertainty grows.
"""

import math

import numpy as np

from processing.arrays import Floats
from processing.estimate import Estimate

_LAG = 16
"""Frames over which a walk shows: noise of single frames hides it between neighbours."""
_MEMORY = 1000
_FEWEST = 32
"""Differences before a walk is believed."""
_SEEN = 1.1
"""Their mean square over that of the noise alone, above which there is motion."""
_DATUM = 16
"""Frames whose mean is the place that all others are counted from."""


class _Axis:
    def __init__(self) -> None:
        self._recent: list[float] = []
        self._count = 0
        self._square = self._noise = 0.0
        self._datum = 0.0
        self._of_datum = 0
        self.level, self.variance, self.walk = math.nan, math.inf, 0.0

    def take(self, place: float, u: float) -> tuple[float, float]:
        """The motion since the datum and its variance, with a frame more; NaN: it was lost."""
        if math.isnan(self.level):
            if not math.isfinite(place):
                return 0.0, 0.0
            self.level = place
        self.variance += self.walk
        if math.isfinite(place):
            self._learn(place, u * u)
            # of the first place nothing was known before
            part = self.variance / (self.variance + u * u) if u > 0 and self.variance < math.inf else 1.0
            self.level += part * (place - self.level)
            self.variance = part * u * u
            if self._of_datum < _DATUM:
                self._of_datum += 1
                self._datum += (place - self._datum) / self._of_datum
        else:
            self._recent.clear()
        return self.level - self._datum, self.variance

    def _learn(self, place: float, noise: float) -> None:
        self._recent.append(place)
        if len(self._recent) <= _LAG:
            return
        difference = place - self._recent.pop(0)
        self._count += 1
        share = 1.0 / min(self._count, _MEMORY)
        self._square += share * (difference * difference - self._square)
        self._noise += share * (2.0 * noise - self._noise)
        moves = self._count >= _FEWEST and self._square > _SEEN * self._noise
        self.walk = (self._square - self._noise) / _LAG if moves else 0.0


class CausalReference:
    """Follows a reference spot frame by frame; `gain` as stated for the pendulum's spot."""

    def __init__(self, gain: Estimate) -> None:
        self._gain = gain
        self._axes = (_Axis(), _Axis())

    def take(self, place_px: Floats, u_px: Floats) -> tuple[Floats, Floats]:
        """What the beam moves the pendulum's spot by in some more frames (n, 2), and its variance.

        `place_px` and `u_px` are of the reference, NaN where it was lost.
        """
        moved, variance = np.zeros(place_px.shape), np.zeros(place_px.shape)
        gain, u_gain = self._gain
        for k, axis in enumerate(self._axes):
            for n, (place, u) in enumerate(zip(place_px[:, k].tolist(), u_px[:, k].tolist(), strict=True)):
                motion, of_motion = axis.take(place, u)
                moved[n, k] = gain * motion
                variance[n, k] = gain * gain * of_motion + (u_gain * motion) ** 2
        return moved, variance
