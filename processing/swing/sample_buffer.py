"""Buffer of the samples that are still needed; new samples are checked."""

import math

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.kernel import kernel
from processing.swing.arc import HalfCycleSamples
from processing.units import seconds

_FINE, _BACKWARDS, _UNCERTAINTY = 0, 1, 2
_FIRST_SIZE = 4096


@kernel
def _fault(times_ns: Ints, deflection: Floats, u_deflection: Floats, last: int) -> tuple[int, int]:
    for i in range(len(times_ns)):
        if times_ns[i] < last:
            return _BACKWARDS, i
        last = times_ns[i]
        if deflection[i] == deflection[i] and not (u_deflection[i] > 0.0 and u_deflection[i] < math.inf):
            return _UNCERTAINTY, i
    return _FINE, 0


class SampleBuffer:
    """Samples in order of time; old ones are dropped. Positions are indices into its arrays."""

    def __init__(self) -> None:
        self.times_ns = np.empty(_FIRST_SIZE, dtype=np.int64)
        self.deflection = np.empty(_FIRST_SIZE)
        self.u_deflection = np.empty(_FIRST_SIZE)
        self.head = 0
        self.tail = 0
        self.last_ns = -(1 << 63)
        self.dropped = 0
        """Number of samples before position 0. Positions shift by its changes, when the arrays are packed."""

    def append(self, times_ns: ArrayLike, deflection: ArrayLike, u_deflection: ArrayLike) -> None:
        """Check a block of samples and add it; raises `DataError` and adds nothing if it is not valid."""
        times = np.ascontiguousarray(times_ns, dtype=np.int64)
        values = np.ascontiguousarray(deflection, dtype=np.float64)
        u_values = np.ascontiguousarray(u_deflection, dtype=np.float64)
        if times.ndim != 1 or values.shape != times.shape or u_values.shape != times.shape:
            raise DataError(
                "times, deflections and uncertainties must be of one length: "
                f"got {times.shape}, {values.shape} and {u_values.shape}"
            )
        n = len(times)
        if n == 0:
            return
        fault, where = _fault(times, values, u_values, self.last_ns)
        if fault == _BACKWARDS:
            before = self.last_ns if where == 0 else int(times[where - 1])
            raise DataError(
                f"times run backwards at sample {where} of the block: "
                f"{int(times[where])} ns after {before} ns; sort the samples or start a new detector"
            )
        if fault == _UNCERTAINTY:
            raise DataError(
                f"uncertainty of sample {where} of the block is {u_values[where]}: "
                "it must be positive and finite where there is a deflection"
            )
        if self.tail + n > len(self.times_ns):
            self._pack(n)
        end = self.tail + n
        self.times_ns[self.tail : end] = times
        self.deflection[self.tail : end] = values
        self.u_deflection[self.tail : end] = u_values
        self.tail = end
        self.last_ns = int(times[-1])

    def _pack(self, n: int) -> None:
        kept = self.tail - self.head
        size = len(self.times_ns)
        while kept + n > size // 2:
            size *= 2
        for name in ("times_ns", "deflection", "u_deflection"):
            old = getattr(self, name)
            new = old if size == len(old) else np.empty(size, dtype=old.dtype)
            new[:kept] = old[self.head : self.tail]
            setattr(self, name, new)
        self.dropped += self.head
        self.head, self.tail = 0, kept

    def position(self, time_ns: int) -> int:
        """Position of the first sample at or after a time."""
        return self.head + int(np.searchsorted(self.times_ns[self.head : self.tail], time_ns))

    def forget_before(self, position: int) -> None:
        """Allow the samples before `position` to be dropped."""
        self.head = max(self.head, min(position, self.tail))

    def between(self, reference_ns: int, side: int, start_ns: int, end_ns: int) -> HalfCycleSamples:
        """Copy of the samples from `start_ns` up to, not including, `end_ns`."""
        i, j = self.position(start_ns), self.position(end_ns)
        return HalfCycleSamples(
            reference_ns,
            side,
            seconds(self.times_ns[i:j] - reference_ns),
            self.deflection[i:j].copy(),
            self.u_deflection[i:j].copy(),
        )
