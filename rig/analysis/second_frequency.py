"""A second oscillation that hides the swing: why the samples of a table hold no usable half-cycle."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.ticks import seconds

_FEWEST: Final = 64
"""Samples in which two oscillations are looked for."""
_HALF_WIDTH: Final = 0.1
"""Of a line's frequency, within which what belongs to it lies, a decay's width included."""
_LEAST_BINS: Final = 4
_BOTH: Final = 0.8
"""Of the variance, that two oscillations hold if they are what the samples show."""
_LARGE: Final = 0.1
"""Of the variance, from which on the weaker one is as large as a swing, nearly."""
_OVERTONES: Final = (2, 3)
"""Ratios of frequencies that one motion has with stops or steps; higher overtones are smaller than _LARGE."""
_NEAR: Final = 0.1


def second_frequency(times_ns: NDArray[np.int64], deflection: NDArray[np.float64]) -> str:
    """The two frequencies that the samples hold, and the remedy; empty where they are not two."""
    good = np.isfinite(deflection)
    if np.count_nonzero(good) < _FEWEST:
        return ""
    since_s = seconds(times_ns - times_ns[0])
    even_s = np.linspace(since_s[0], since_s[-1], len(since_s))
    even = np.interp(even_s, since_s[good], deflection[good])
    power = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(len(even)))) ** 2
    # what lies below three turns in the record is a drift
    power[:_LEAST_BINS] = 0.0
    total = float(power.sum())
    lines: list[tuple[float, float]] = []
    for _ in range(2):
        k = int(np.argmax(power))
        width = max(_LEAST_BINS, round(_HALF_WIDTH * k))
        near = slice(max(k - width, 0), k + width + 1)
        lines.append((k / float(even_s[-1]), float(power[near].sum())))
        power[near] = 0.0
    (first_hz, first), (second_hz, second) = sorted(lines)
    ratio = second_hz / first_hz if first_hz > 0 else 0.0
    harmonic = any(abs(ratio - overtone) < _NEAR for overtone in _OVERTONES)
    if not first + second > _BOTH * total or min(first, second) < _LARGE * total or harmonic:
        return ""
    size = (second / first) ** 0.5
    return (
        f"the samples hold two oscillations, at {first_hz:.3g} Hz and at {second_hz:.3g} Hz, the second "
        f"{size:.2g} times as large as the first, so that no half-cycle is one of a free decay; damp or "
        "filter one of them, begin where it has faded (--from), or choose a position that does not "
        "see it (--position)"
    )
