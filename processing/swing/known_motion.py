"""Known frequency and waveform of the motion, so that only amplitude, time and centre have to be fitted."""

from dataclasses import astuple, dataclass

import numpy as np

from processing.arrays import Floats
from processing.swing.half_cycle import RATE, SHAPE, STATES
from processing.swing.waveform import SHAPES


@dataclass(frozen=True, slots=True)
class KnownMotion:
    """Frequency and shape of the half-swing at every amplitude (see `waveform` for the equation).

    `rate_rad_per_s` is the angular frequency of the linear part of the waveform's equation at the amplitude
    `reference`, which has the unit of the deflection. The fields from `damping` to `bend` are dimensionless,
    in the order of the state's shape terms. `drive` is the step by which the ground moves either quadrature
    in a half-swing, in the unit of the deflection: a rest that seems to move hides one that is unknown.
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
    drive: float = 0.0

    def put_into(self, x: Floats) -> Floats:
        """Copy of the state `x` (see `half_cycle`) with this motion's frequency and shape."""
        out = np.array(x, dtype=np.float64)
        assert out.shape == (STATES,)
        out[RATE] = self.rate_rad_per_s
        out[SHAPE : SHAPE + SHAPES] = astuple(self)[2 : 2 + SHAPES]
        return out
