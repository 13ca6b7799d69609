"""Harmonics of the swing, measured over pieces of four half-pieces.

An oscillation whose amplitude and phase change as squares of time, with a drifting rest position, and its
harmonics are fitted to the deflections of every piece. So the decay makes no harmonic, and neither does what
the ground does slowly. Phases count from the turning point of the oscillation itself. Pieces do not overlap.

A moment that turns over with the velocity, friction, makes odd harmonics in quadrature (sines). Those in
phase come from elastic moments, the lever and errors of position on the sensor; even ones in quadrature from
rows that are exposed in turn. A drag makes none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Complexes, Floats
from processing.deflections import Deflections, joined
from processing.swing.cycle_residuals import fast_mode, without
from processing.swing.swing import HalfCycle

ORDERS = tuple(range(2, 10))
HALVES = 4
"""Half-cycles of a piece: with two the changes of amplitude and phase hide most of the harmonics."""
_OWN = 8
_LEAST = 1e-9
"""Added to a normal matrix with a diagonal of ones: a harmonic at the fast mode's frequency is unknown."""
_GATE = 6.0
"""Standard deviations: of noise alone 2e-9 of the samples lie beyond."""
_LATE_NS = 120_000_000_000
"""Deflections that are kept until the first half-cycles are found in them."""
_FEWEST_HALF_CYCLES = 4
"""Fewest pieces of a class."""


class SwingTerms:
    """The terms of a piece: rest position and drift, an oscillation that changes, and its harmonics."""

    COUNT = _OWN + 2 * len(ORDERS)

    @staticmethod
    def at(x: Floats) -> Floats:
        """Terms (n, COUNT) at times x, -1 at the first turning point of the piece and 1 at the last."""
        phase = 0.5 * np.pi * HALVES * (x + 1)
        cos, sin = np.cos(phase), np.sin(phase)
        terms = [cos, sin, np.ones_like(x), x, x * cos, x * sin, x * x * cos, x * x * sin]
        for order in ORDERS:
            terms += [np.cos(order * phase), np.sin(order * phase)]
        return np.column_stack(terms)

    @staticmethod
    def harmonics(values: Floats) -> tuple[Floats, Complexes]:
        """Amplitudes (n,) and harmonics (n, orders) from coefficients (n, COUNT), counted from +A."""
        own = values[:, 0] - 1j * values[:, 1]
        turned = np.exp(-1j * np.angle(own)[:, None] * np.array(ORDERS))
        return np.abs(own), (values[:, _OWN::2] - 1j * values[:, _OWN + 1 :: 2]) * turned


@dataclass(frozen=True, slots=True)
class SwingHarmonics:
    """Amplitude (n,) and complex harmonics of `ORDERS`, shape (n, orders), of n pieces.

    The deflection is ``A cos(s) + Re sum X_k exp(i k s)`` with the phase s from the turning point at +A.
    `covariance_sine` (n, orders, orders) is that of ``-Im X`` by the stated uncertainties of the samples.
    """

    amplitude: Floats
    harmonics: Complexes
    covariance_sine: Floats

    def __len__(self) -> int:
        return len(self.amplitude)

    @property
    def sine(self) -> Floats:
        """What is in quadrature, ``-Im X``."""
        return np.asarray(-self.harmonics.imag)


class HarmonicsWatch:
    """Measures the harmonics in deflections that pass.

    Parameters
    ----------
    swings
        Half-cycles of these deflections, as far as they are known; others may follow. Five neighbours without
        a flag make a piece; the fifth is the first of the next one.
    """

    def __init__(self, swings: Sequence[HalfCycle] = ()) -> None:
        self._pieces: list[tuple[HalfCycle, HalfCycle]] = []
        self._run: list[HalfCycle] = []
        self._kept: list[Deflections] = []
        self._values: list[Floats] = []
        self._covariances: list[Floats] = []
        self.add(swings)

    def add(self, swings: Sequence[HalfCycle]) -> None:
        """Half-cycles that follow, of deflections that have passed or will."""
        for swing in swings:
            if swing.flags or (self._run and swing.index != self._run[-1].index + 1):
                self._run = []
            if not swing.flags:
                self._run.append(swing)
            if len(self._run) == HALVES + 1:
                self._pieces.append((self._run[0], self._run[-1]))
                self._run = self._run[-1:]
        self._measure_all()

    def update(self, block: Deflections) -> None:
        """Take the deflections that follow."""
        if not len(block):
            return
        self._kept.append(block)
        self._measure_all()
        newest_ns = int(block.times_ns[-1])
        if not self._pieces and not self._run:
            # where nothing swings yet, what a piece may need that is found late
            while int(self._kept[0].times_ns[-1]) < newest_ns - _LATE_NS:
                self._kept.pop(0)

    def _measure_all(self) -> None:
        if not self._kept or not self._pieces:
            return
        if self._pieces[0][1].turn_time_ns > int(self._kept[-1].times_ns[-1]):
            return
        kept = joined(self._kept, self._kept[0].unit)
        while self._pieces and self._pieces[0][1].turn_time_ns <= int(kept.times_ns[-1]):
            first, last = self._pieces.pop(0)
            begin, end = np.searchsorted(kept.times_ns, [first.turn_time_ns, last.turn_time_ns])
            self._measure(kept[int(begin) : int(end)], first, last)
        needed = self._pieces[0][0] if self._pieces else self._run[0] if self._run else None
        self._kept = [kept if needed is None else kept.since(needed.turn_time_ns)]

    def found(self) -> SwingHarmonics:
        """All pieces so far; none where the samples are too few."""
        count, values = len(ORDERS), np.array(self._values).reshape(-1, SwingTerms.COUNT)
        covariance = np.array(self._covariances).reshape(-1, count, count)
        return SwingHarmonics(*SwingTerms.harmonics(values), covariance)

    def _measure(self, samples: Deflections, first: HalfCycle, last: HalfCycle) -> None:
        usable = np.isfinite(samples.y) & (samples.u_y > 0.0)
        if np.count_nonzero(usable) < 2 * SwingTerms.COUNT:
            return
        samples = samples[usable]
        span_ns = last.turn_time_ns - first.turn_time_ns
        x = 2.0 * (samples.times_ns - first.turn_time_ns) / span_ns - 1.0
        terms = SwingTerms.at(x)
        fast = fast_mode(x, samples.x, terms)
        if fast is not None:
            terms = np.column_stack([terms, fast])
        weight = 1.0 / samples.u_y
        left = np.abs(without(samples.y, terms, weight)) * weight
        weight = np.where(left > _GATE * max(1.0, 1.4826 * float(np.median(left))), 0.0, weight)
        weighted = terms * weight[:, None]
        norm = np.sqrt(np.sum(weighted**2, axis=0))
        normal = (weighted.T @ weighted) / np.outer(norm, norm) + _LEAST * np.eye(len(norm))
        covariance = np.linalg.inv(normal) / np.outer(norm, norm)
        values = covariance @ (weighted.T @ (weight * samples.y))
        if not np.all(np.isfinite(values)):
            return
        sine = slice(_OWN + 1, SwingTerms.COUNT, 2)
        # a piece that begins at -A is turned by half a period
        sign = float(first.side) ** np.array(ORDERS)
        self._values.append(values[: SwingTerms.COUNT])
        self._covariances.append(covariance[sine, sine] * np.outer(sign, sign))


@dataclass(frozen=True, slots=True)
class HarmonicClass:
    """Mean harmonics of the pieces of like amplitude.

    `u` are the standard uncertainties of real and imaginary part, shape (orders,). `mean` is the operation by
    which harmonics of the single pieces became one value at `amplitude`, for predictions as well.
    """

    amplitude: float
    amplitudes: Floats
    harmonics: Complexes
    u: Floats

    def mean(self, predicted: Callable[[Floats], Complexes]) -> Complexes:
        """A law's harmonics of the class, from its harmonics (n, orders) at amplitudes (n,)."""
        return _at_middle(self.amplitudes, predicted(self.amplitudes))[0]


def harmonic_classes(pieces: SwingHarmonics) -> list[HarmonicClass]:
    """Classes of amplitudes that differ by up to a factor of two, the largest first."""
    out = []
    left = pieces.amplitude
    top = float(left.max()) if len(left) else 0.0
    while top > 0 and np.any(left <= top):
        inside = (pieces.amplitude <= top) & (pieces.amplitude > top / 2)
        if np.count_nonzero(inside) >= _FEWEST_HALF_CYCLES:
            amplitudes = pieces.amplitude[inside]
            mean, u = _at_middle(amplitudes, pieces.harmonics[inside])
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
