"""What the samples' noise is, learned from the residuals of the half-cycles: its size, and its colour.

Air, a pointing that walks and what a drive does within a half-cycle leave residuals that are slow. In white
noise each cosine of a series over the half-cycle holds the same power; here the slow ones hold more, and
amplitude and time of the turning point, which are slower still, suffer more than the scatter of the samples
tells. What stands at 4 to 6 times the pendulum's frequency is seen; at the frequency itself it cannot be
told from the motion. It is taken to rise like 1/f from there.
"""

import math
from collections import deque
from typing import NamedTuple

from processing.swing.half_cycle_fit import HalfCycleFit

_MEMORY = 15
"""Number of half-cycles whose median reduced chi-square gives the factor on the samples' uncertainties."""
_SLOW_MEMORY = 63
"""Their median is known to 0.13, so that noise counts as slow from 1.8 times the power of white noise on."""
_MEDIAN = 0.789
"""Median of a chi-square of three degrees of freedom, per degree."""
_SPREAD = 1.02
"""Standard deviation of the median of m such values, times sqrt(m)."""
_SIGNIFICANT = 6.0
"""Standard deviations of the median: it is looked at after every half-cycle of runs of thousands."""
_RISE = 4.0
"""Power at 1.25 times the pendulum's frequency, about where turning points take it up, relative to that at
five times, in noise of 1/f."""
_CENTRE_RISE = 9.0
"""The same at half the frequency, about where the centre takes it up."""


class NoiseLevel(NamedTuple):
    """Noise of the samples in units of their stated uncertainties.

    `scale` is the factor on them, `colour` a further one on what follows for turning points, and `amplitude`
    one more on amplitudes, in which the centre's error stands as well. `concentration` is the power of the
    slow residuals relative to white ones: so many times fewer are independent.
    """

    scale: float
    colour: float = 1.0
    amplitude: float = 1.0
    concentration: float = 1.0

    @property
    def effective(self) -> float:
        """Factor on the samples' uncertainties with which white noise would harm turning points as much."""
        return self.scale * self.colour


class SampleNoise:
    """Learns the noise, half-cycle by half-cycle."""

    def __init__(self, scale: float) -> None:
        self.level = NoiseLevel(scale)
        self._ratios: deque[float] = deque([scale**2] * _MEMORY, maxlen=_MEMORY)
        self._slow: deque[float] = deque(maxlen=_SLOW_MEMORY)

    def learn(self, result: HalfCycleFit) -> None:
        """Take in one more half-cycle without gaps."""
        degrees = max(result.samples - 2, 1)
        self._ratios.append(result.chi2 / degrees)
        median = sorted(self._ratios)[_MEMORY // 2]
        scatter = 1.25 * math.sqrt(2.0 / degrees / _MEMORY)
        scale = math.sqrt(median) if median > 1.0 + 4.0 * scatter else 1.0
        self.level = NoiseLevel(scale, *self._colour(scale, result))

    def _colour(self, scale: float, result: HalfCycleFit) -> tuple[float, float, float]:
        if math.isfinite(result.slow):
            self._slow.append(result.slow)
        count = len(self._slow)
        if not count:
            return 1.0, 1.0, 1.0
        power = sorted(self._slow)[count // 2] / (_MEDIAN * scale**2)
        if power < 1.0 + _SIGNIFICANT * _SPREAD / math.sqrt(count):
            return 1.0, 1.0, 1.0
        colour, amplitude = (math.sqrt(1.0 + rise * (power - 1.0)) for rise in (_RISE, _CENTRE_RISE))
        return colour, amplitude / colour, power
