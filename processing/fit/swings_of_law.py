"""What a law's half-swing map says at the points of a decay, kept for the parameters that were asked last."""

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.contact import HalfSwings, OneHalfSwing, tabulated_half_swing
from processing.contact.laws import Law


class SwingsOfLaw:
    """The map of a law for the half-cycles `index`, of measured amplitudes `x` in units of the reference.

    Searches begin and end where others have been: copies of a model share what is kept here.
    """

    def __init__(self, law: Law, index: NDArray[np.int64], x: Floats) -> None:
        self._law, self._index, self._x = law, index, x
        self._tabulated: dict[bytes, OneHalfSwing] = {}
        self._swung: dict[bytes, HalfSwings] = {}

    def at_the_points(self, parameters: Floats) -> HalfSwings:
        """The law's map at the indices of the points."""
        key = parameters.tobytes()
        if key not in self._swung:
            self._swung.clear()
            self._swung[key] = self._law.half_swing_map(parameters, self._index)
        return self._swung[key]

    def through_the_decay(self, parameters: Floats) -> OneHalfSwing | None:
        """One half-swing at all amplitudes of the data; None if it cannot be had for these parameters."""
        if not np.all(np.isfinite(parameters)):
            return None
        key = parameters[:-3].tobytes()
        if key not in self._tabulated:
            highest, lowest = 1.05 * float(self._x.max()), 0.9 * float(self._x.min())
            count = int(1.1 * self._index[-1]) + 20
            while True:
                table = tabulated_half_swing(self._law.half_swing_map, parameters[:-2], highest, count)
                reached = len(table.amplitude)
                if reached < count or count > 4 * self._index[-1] or table.amplitude[-1] < lowest:
                    break
                count *= 2
            self._tabulated.clear()
            self._tabulated[key] = table
        table = self._tabulated[key]
        return table if len(table.amplitude) > 1 else None
