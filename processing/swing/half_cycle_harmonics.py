"""Harmonics of the oscillation, measured over pieces of four half-cycles each.

The deflections of a piece are fitted by an oscillation whose amplitude and phase are quadratic in time, a
drifting rest position, and the harmonics. Therefore neither the decay nor slow motion of the ground makes a
harmonic. Phases count from the turning point of the oscillation itself. Pieces do not overlap.

Friction, a moment that changes its sign with the velocity, makes odd harmonics in quadrature (sines). Odd
harmonics in phase come from elastic moments, the lever and errors of position on the sensor, even harmonics
in quadrature from a rolling shutter. A drag makes no harmonics.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from processing.arrays import Complexes, Floats
from processing.deflections import Deflections, joined
from processing.noise_models import robust_scatter
from processing.swing.cycle_residuals import fast_mode_derivatives, linear_fit_residuals
from processing.swing.half_cycle_fit import OUTLIER_U
from processing.swing.turning_point import HalfCycle

ORDERS = tuple(range(2, 10))
"""Orders of the harmonics that are measured."""
PIECE_HALF_CYCLES = 4
"""Half-cycles of a piece: with two the changes of amplitude and phase hide most of the harmonics."""
_MOTION_TERMS = 8
"""Number of terms of a piece before those of the harmonics."""
_RIDGE = 1e-9
"""Ridge on a normal matrix of unit diagonal: a harmonic at the fast mode's frequency is not determined."""
_STORED_NS = 120_000_000_000
"""Length of the deflections that are stored while no half-cycle is known, since half-cycles follow later."""


class HarmonicTerms:
    """Terms of a piece: an oscillation that changes, rest position and drift, and the harmonics."""

    COUNT = _MOTION_TERMS + 2 * len(ORDERS)

    @staticmethod
    def evaluate(x: Floats) -> Floats:
        """Terms (n, COUNT) at times x, -1 at the first turning point of the piece and 1 at the last."""
        phase = 0.5 * np.pi * PIECE_HALF_CYCLES * (x + 1)
        cos, sin = np.cos(phase), np.sin(phase)
        terms = [cos, sin, np.ones_like(x), x, x * cos, x * sin, x * x * cos, x * x * sin]
        for order in ORDERS:
            terms += [np.cos(order * phase), np.sin(order * phase)]
        return np.column_stack(terms)

    @staticmethod
    def harmonics(values: Floats) -> tuple[Floats, Complexes]:
        """Amplitudes (n,) and harmonics (n, orders), phase 0 at +A, from coefficients (n, COUNT)."""
        fundamental = values[:, 0] - 1j * values[:, 1]
        rotation = np.exp(-1j * np.angle(fundamental)[:, None] * np.array(ORDERS))
        cosines, sines = values[:, _MOTION_TERMS::2], values[:, _MOTION_TERMS + 1 :: 2]
        return np.abs(fundamental), (cosines - 1j * sines) * rotation


@dataclass(frozen=True, slots=True)
class PieceHarmonics:
    """Harmonics of n pieces, in the unit of the deflection.

    The deflection is ``A cos(s) + Re sum X_k exp(i k s)`` with the phase s from the turning point at +A.
    """

    amplitude: Floats
    """(n,) amplitude A of the oscillation itself."""
    harmonics: Complexes
    """(n, orders) complex amplitudes X_k of the `ORDERS` k."""
    covariance_sine: Floats
    """(n, orders, orders) covariance of ``-Im X`` by the stated uncertainties of the samples."""

    def __len__(self) -> int:
        return len(self.amplitude)

    @property
    def sine(self) -> Floats:
        """Harmonics in quadrature, ``-Im X``, (n, orders)."""
        return np.asarray(-self.harmonics.imag)


class HarmonicsMeasurement:
    """Measurement of the harmonics in deflections that come block by block.

    Five half-cycles in a row without a flag bound a piece; the fifth is the first of the next piece.
    """

    def __init__(self, half_cycles: Sequence[HalfCycle] = ()) -> None:
        self._pieces: list[tuple[HalfCycle, HalfCycle]] = []
        self._run: list[HalfCycle] = []
        self._blocks: list[Deflections] = []
        self._values: list[Floats] = []
        self._covariances: list[Floats] = []
        self.add(half_cycles)

    def add(self, half_cycles: Sequence[HalfCycle]) -> None:
        """Add the half-cycles that follow, before or after their deflections."""
        for half_cycle in half_cycles:
            if half_cycle.flags or (self._run and half_cycle.index != self._run[-1].index + 1):
                self._run = []
            if not half_cycle.flags:
                self._run.append(half_cycle)
            if len(self._run) == PIECE_HALF_CYCLES + 1:
                self._pieces.append((self._run[0], self._run[-1]))
                self._run = self._run[-1:]
        self._measure_all()

    def update(self, block: Deflections) -> None:
        """Add the deflections that follow."""
        if not len(block):
            return
        self._blocks.append(block)
        self._measure_all()
        newest_ns = int(block.times_ns[-1])
        if not self._pieces and not self._run:
            # no half-cycle is known yet: one that is found later may need the newest deflections
            while int(self._blocks[0].times_ns[-1]) < newest_ns - _STORED_NS:
                self._blocks.pop(0)

    def _measure_all(self) -> None:
        if not self._blocks or not self._pieces:
            return
        if self._pieces[0][1].turn_time_ns > int(self._blocks[-1].times_ns[-1]):
            return
        stored = joined(self._blocks, self._blocks[0].unit)
        while self._pieces and self._pieces[0][1].turn_time_ns <= int(stored.times_ns[-1]):
            first, last = self._pieces.pop(0)
            begin, end = np.searchsorted(stored.times_ns, [first.turn_time_ns, last.turn_time_ns])
            self._measure(stored[int(begin) : int(end)], first, last)
        next_first = self._pieces[0][0] if self._pieces else self._run[0] if self._run else None
        self._blocks = [stored if next_first is None else stored.since(next_first.turn_time_ns)]

    def harmonics(self) -> PieceHarmonics:
        """Harmonics of all pieces so far, except those of too few samples."""
        count, values = len(ORDERS), np.array(self._values).reshape(-1, HarmonicTerms.COUNT)
        covariance = np.array(self._covariances).reshape(-1, count, count)
        return PieceHarmonics(*HarmonicTerms.harmonics(values), covariance)

    def _measure(self, samples: Deflections, first: HalfCycle, last: HalfCycle) -> None:
        usable = np.isfinite(samples.y) & (samples.u_y > 0.0)
        if np.count_nonzero(usable) < 2 * HarmonicTerms.COUNT:
            return
        samples = samples[usable]
        span_ns = last.turn_time_ns - first.turn_time_ns
        x = 2.0 * (samples.times_ns - first.turn_time_ns) / span_ns - 1.0
        terms = HarmonicTerms.evaluate(x)
        fast_mode = fast_mode_derivatives(x, samples.x, terms)
        if fast_mode is not None:
            terms = np.column_stack([terms, fast_mode])
        root_weight = 1.0 / samples.u_y
        normalised = np.abs(linear_fit_residuals(samples.y, terms, root_weight)) * root_weight
        is_outlier = normalised > OUTLIER_U * max(1.0, robust_scatter(normalised, middle=0.0))
        root_weight = np.where(is_outlier, 0.0, root_weight)
        weighted = terms * root_weight[:, None]
        norm = np.sqrt(np.sum(weighted**2, axis=0))
        normal = (weighted.T @ weighted) / np.outer(norm, norm) + _RIDGE * np.eye(len(norm))
        covariance = np.linalg.inv(normal) / np.outer(norm, norm)
        values = covariance @ (weighted.T @ (root_weight * samples.y))
        if not np.all(np.isfinite(values)):
            return
        sine = slice(_MOTION_TERMS + 1, HarmonicTerms.COUNT, 2)
        # a piece that begins at -A is shifted by half a period
        sign = float(first.side) ** np.array(ORDERS)
        self._values.append(values[: HarmonicTerms.COUNT])
        self._covariances.append(covariance[sine, sine] * np.outer(sign, sign))
