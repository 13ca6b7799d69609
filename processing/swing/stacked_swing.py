"""Harmonics of the swing: deflections stacked by phase, cycle by cycle, and by classes of amplitude.

The deflections of four cycles, weighted by a window that falls to zero at both ends, are fitted by the
oscillation with its harmonics; the oscillation may change as a square of time, so that its decay makes no
harmonic, and the rest position may drift. Phases count from the turning point of the oscillation itself.
Pieces do not overlap, and their scatter gives the uncertainty.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from processing.arrays import Complexes, Floats
from processing.swing.swing import TurningPoints

ORDERS = (2, 3, 4, 5)
_TERMS = 2 + 6 + 2 * len(ORDERS)
_HALVES = 8
"""Half-cycles of a piece."""
_FEWEST = 4
"""Fewest pieces of a class."""


@dataclass(frozen=True, slots=True)
class CycleHarmonics:
    """Amplitude and the complex harmonics of `ORDERS`, shape (cycles, 4), of single cycles.

    The deflection is ``A cos(s) + Re sum X_k exp(i k s)`` with the phase s from the turning point at +A.
    """

    amplitude: Floats
    harmonics: Complexes


@dataclass(frozen=True, slots=True)
class HarmonicClass:
    """Mean harmonics of the cycles of like amplitude.

    `u` are the standard uncertainties of real and imaginary part, shape (4,). `mean` is the operation by
    which harmonics of the single pieces became one value at `amplitude`, for predictions as well.
    """

    amplitude: float
    amplitudes: Floats
    harmonics: Complexes
    u: Floats

    def mean(self, predicted: Callable[[Floats], Complexes]) -> Complexes:
        """A law's harmonics of the class, from its harmonics (n, 4) at amplitudes (n,)."""
        return _at_middle(self.amplitudes, predicted(self.amplitudes))[0]


def cycle_harmonics(time_s: Floats, deflection: Floats, points: TurningPoints) -> CycleHarmonics:
    """Harmonics of every whole cycle; cycles with a missing turning point or too few samples are left out.

    Parameters
    ----------
    time_s, deflection
        Samples in order of time, on the clock of the turning points; NaN where the spot was lost.
    points
        Turning points of the motion.
    """
    found = np.isfinite(deflection)
    time_s, deflection = time_s[found], deflection[found]
    amplitudes, harmonics = [], []
    following = 0
    for first in range(len(points) - _HALVES):
        if first < following or points.index[first + _HALVES] - points.index[first] != _HALVES:
            continue
        begins, ends = points.time_s[first], points.time_s[first + _HALVES]
        rows = slice(*np.searchsorted(time_s, [begins, ends]))
        if rows.stop - rows.start < 3 * _TERMS:
            continue
        t = 2 * (time_s[rows] - begins) / (ends - begins) - 1
        phase, weight = np.pi * (_HALVES // 2) * (t + 1), np.cos(0.5 * np.pi * t)
        cos, sin = np.cos(phase), np.sin(phase)
        terms = [cos, sin, np.ones_like(t), t, t * cos, t * sin, t * t * cos, t * t * sin]
        for order in ORDERS:
            terms += [np.cos(order * phase), np.sin(order * phase)]
        values = np.linalg.lstsq(
            weight[:, None] * np.column_stack(terms), weight * deflection[rows], rcond=None
        )[0]
        own = complex(values[0], -values[1])
        turned = np.exp(-1j * np.angle(own) * np.array(ORDERS))
        amplitudes.append(abs(own))
        harmonics.append((values[8::2] - 1j * values[9::2]) * turned)
        following = first + _HALVES
    return CycleHarmonics(np.array(amplitudes), np.array(harmonics).reshape(-1, len(ORDERS)))


def harmonic_classes(cycles: CycleHarmonics) -> list[HarmonicClass]:
    """Classes of amplitudes that differ by up to a factor of two, the largest first."""
    out = []
    left = cycles.amplitude
    top = float(left.max()) if len(left) else 0.0
    while top > 0 and np.any(left <= top):
        inside = (cycles.amplitude <= top) & (cycles.amplitude > top / 2)
        if np.count_nonzero(inside) >= _FEWEST:
            amplitudes = cycles.amplitude[inside]
            mean, u = _at_middle(amplitudes, cycles.harmonics[inside])
            out.append(HarmonicClass(float(np.exp(np.mean(np.log(amplitudes)))), amplitudes, mean, u))
        top /= 2
    return out


def _at_middle(amplitudes: Floats, harmonics: Complexes) -> tuple[Complexes, Floats]:
    """Value and uncertainty at the geometric mean amplitude, by a straight line over ln A."""
    x = np.log(amplitudes)
    terms = np.column_stack([np.ones_like(x), x - np.mean(x)])
    line = np.linalg.lstsq(terms, harmonics, rcond=None)[0]
    left = harmonics - terms @ line
    variance = np.sum(np.abs(left) ** 2, axis=0) / (2 * (len(x) - 2))
    return line[0], np.sqrt(variance / len(x))
