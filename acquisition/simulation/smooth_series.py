"""Smooth functions of time, random or not: quintic splines over even knots, computed block by block.

Stationary noise of a given spectrum is the spline whose B-spline coefficients are filtered white noise. The
filter's gain is the wanted amplitude spectral density divided by that of the B-spline, sinc(f/rate)^6, and
falls to 0 between the band's end and 1.25 times it. With four knots per period of the band's end, the images
of the band about the knots' rate hold less than 1e-5 of its power (8e-5 in the falling part). Between knots
the result is a polynomial, which an integrator that stops at the knots integrates without error. A series
does not depend on when, and in which steps, it is read. Memory holds two blocks.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from acquisition.simulation import randomness
from processing.kernel import kernel

DEGREE: Final = 5
KNOTS_PER_PERIOD = 4
"""Knots per period of the highest frequency of the band."""
BLOCK_KNOTS = 32_000
TAPS = 2**15
"""Length of the filter in knots; its reciprocal is the resolution of the spectrum."""
_FFT = 2 * TAPS
_COLUMNS = 64
_FALL_RATIO = 1.25
"""Frequency at which the spectrum has fallen to 0, over the end of the band."""
_MARGIN_KNOTS = 40
"""Knots beyond a block within which the end of the data affects the coefficients of a spline."""

Term = Callable[[int], NDArray[np.float64]]
"""B-spline coefficients of a block, (BLOCK_KNOTS + DEGREE,): the first belongs to the knot two before it."""


class Pieces(NamedTuple):
    """A function of time as polynomials between even knots, from `start_s` on."""

    start_s: float
    step_s: float
    coefficients: NDArray[np.float64]
    """Rising powers (m, 6): row k holds from ``start_s + k step_s`` on, in units of `step_s` since then. No
    rows: the function is zero everywhere."""


def _basis() -> NDArray[np.float64]:
    """Contribution (6, 6) of six neighbouring coefficients to the polynomial between the middle two."""
    from scipy.interpolate import BSpline, PPoly

    spline = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    falling_powers = PPoly.from_spline(spline.tck).c[:, DEGREE:-DEGREE]
    return np.ascontiguousarray(falling_powers.T[::-1, ::-1], dtype=np.float64)


class Stretch(NamedTuple):
    """Row `knot` of the pieces, from the position `begin` in it on, in units of `step_s`."""

    pieces: Pieces
    knot: int
    begin: float


@kernel
def value_after(stretch: Stretch, since_s: float) -> float:
    """Value of the function at a time `since_s` after the begin of a stretch."""
    rows = stretch.pieces.coefficients
    if rows.shape[0] == 0:
        return 0.0
    u = stretch.begin + since_s / stretch.pieces.step_s
    value = 0.0
    for k in range(rows.shape[1] - 1, -1, -1):
        value = value * u + rows[stretch.knot, k]
    return value


@kernel
def stretch_at(pieces: Pieces, time_s: float) -> tuple[Stretch, float]:
    """The stretch that begins at a time, and its length in s up to the next knot; without pieces infinite."""
    if pieces.coefficients.shape[0] == 0:
        return Stretch(pieces, 0, 0.0), math.inf
    place = (time_s - pieces.start_s) / pieces.step_s
    # by rounding, a time may lie just before the knot at which the last step ended, also the last knot
    knot = min(math.floor(place + 1e-6), pieces.coefficients.shape[0] - 1)
    return Stretch(pieces, knot, place - knot), pieces.start_s + (knot + 1) * pieces.step_s - time_s


class SmoothSeries:
    """A sum of terms as one function of time, from 0 on.

    Parameters
    ----------
    rate_hz
        Knots per second.
    terms
        Pairs of a factor and the term that it multiplies.
    end_s
        End of the time in which the series is known; a reader stops there.
    """

    def __init__(self, rate_hz: float, terms: Sequence[tuple[float, Term]], end_s: float = math.inf) -> None:
        self.rate_hz = rate_hz
        self.end_s = end_s
        self._terms = tuple(terms)
        self._basis = _basis()
        self._blocks: dict[int, Pieces] = {}

    def pieces(self, time_s: float) -> Pieces:
        """The block that contains a time before `end_s`; 1e-6 of a step before a knot counts as the knot."""
        block = math.floor(time_s * self.rate_hz + 1e-6) // BLOCK_KNOTS
        if block not in self._blocks:
            total = np.zeros(BLOCK_KNOTS + DEGREE)
            for factor, term in self._terms:
                total += factor * term(block)
            left = min(self.end_s * self.rate_hz - block * BLOCK_KNOTS + 1e-6, BLOCK_KNOTS)
            pieces = (sliding_window_view(total, DEGREE + 1) @ self._basis)[: math.floor(left)]
            if len(self._blocks) == 2:
                del self._blocks[min(self._blocks)]
            self._blocks[block] = Pieces(block * BLOCK_KNOTS / self.rate_hz, 1 / self.rate_hz, pieces)
        return self._blocks[block]

    def at(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values at times (n,) before `end_s`, which must not decrease."""
        values = np.empty(len(times_s))
        done = 0
        while done < len(times_s):
            pieces = self.pieces(times_s[done])
            position = (times_s[done:] - pieces.start_s) / pieces.step_s
            position = position[: np.searchsorted(position, BLOCK_KNOTS - 1e-6)]
            knot = np.maximum(np.floor(position), 0.0).astype(np.int64)
            u = position - knot
            value = np.zeros(len(position))
            for power in range(DEGREE, -1, -1):
                value = value * u + pieces.coefficients[knot, power]
            values[done : done + len(position)] = value
            done += len(position)
        return values


class BandNoise:
    """Stationary normal noise of a stated spectrum: a `Term`.

    Parameters
    ----------
    density
        Amplitude spectral density, one-sided, as a function of frequencies in Hz, in the unit of the series
        over sqrt(Hz). Its resolution is `rate_hz`/`TAPS`; below twice that it is unreliable; its mean is 0.
    rate_hz
        Knots per second, at least `KNOTS_PER_PERIOD` times `band_hz`.
    band_hz
        The spectrum holds up to this frequency, and is cut off above.
    key
        Seed, run and purpose.
    """

    def __init__(
        self,
        density: Callable[[NDArray[np.float64]], NDArray[np.float64]],
        rate_hz: float,
        band_hz: float,
        key: tuple[int, int, int],
    ) -> None:
        frequencies_hz = np.arange(1, TAPS // 2 + 1) * (rate_hz / TAPS)
        fall = np.clip((frequencies_hz / band_hz - 1) / (_FALL_RATIO - 1), 0, 1)
        in_band = fall < 1
        gain = np.zeros(TAPS // 2 + 1)
        gain[1:][in_band] = (
            density(frequencies_hz[in_band])
            * math.sqrt(rate_hz / 2)
            * np.cos(0.5 * np.pi * fall[in_band])
            / np.sinc(frequencies_hz[in_band] / rate_hz) ** (DEGREE + 1)
        )
        # without the window, a step of the spectrum would cause ripples in all of it
        taps = np.roll(np.fft.irfft(gain), TAPS // 2) * np.sin(np.pi * np.arange(TAPS) / TAPS) ** 2
        self._response = np.conj(np.fft.rfft(taps, _FFT))
        self._key = key

    def __call__(self, block: int) -> NDArray[np.float64]:
        first = block * (BLOCK_KNOTS // _COLUMNS)
        white = randomness.normals(*self._key, first, (_FFT // _COLUMNS, _COLUMNS))
        filtered = np.fft.irfft(np.fft.rfft(white.reshape(-1)) * self._response)
        return filtered[: BLOCK_KNOTS + DEGREE]


def coefficients_through(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """B-spline coefficients of the quintic spline through values at even knots, mirrored at both ends."""
    from scipy.ndimage import spline_filter1d

    return np.asarray(spline_filter1d(values, order=DEGREE, mode="mirror", output=np.float64))


def sampled(function: Callable[[NDArray[np.float64]], NDArray[np.float64]], rate_hz: float) -> Term:
    """A smooth function of time as a `Term`, from its values at the knots."""

    def term(block: int) -> NDArray[np.float64]:
        first = block * BLOCK_KNOTS - 2
        knots = np.arange(first - _MARGIN_KNOTS, first + BLOCK_KNOTS + DEGREE + _MARGIN_KNOTS)
        return coefficients_through(function(knots / rate_hz))[_MARGIN_KNOTS:-_MARGIN_KNOTS]

    return term
