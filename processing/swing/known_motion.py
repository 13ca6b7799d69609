"""A motion that is known from elsewhere, so that a half-cycle has only to be found on it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.swing.half_cycle import RATE, SHAPE, STATES
from processing.swing.waveform import SHAPES


@dataclass(frozen=True, slots=True)
class KnownMotion:
    """Frequency and shape of the half-swing at every amplitude (see waveform).

    `rate_rad_per_s` belongs to the linear part of the waveform's equation at the amplitude `reference`,
    which has the unit of the deflection. The others are dimensionless.
    """

    rate_rad_per_s: float
    reference: float
    damping: float = 0.0
    dry: float = 0.0
    rise: float = 0.0
    p: float = 1.0
    stiff: float = 0.0
    n: float = 1.0
    bend: float = 0.0

    def put_into(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The state `x` (see half_cycle) with this motion's frequency and shape."""
        out = np.array(x, dtype=np.float64)
        assert out.shape == (STATES,)
        out[RATE] = self.rate_rad_per_s
        out[SHAPE : SHAPE + SHAPES] = (
            self.damping,
            self.dry,
            self.rise,
            self.p,
            self.stiff,
            self.n,
            self.bend,
        )
        return out
