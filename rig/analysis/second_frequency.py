"""A second oscillation in a table: why no half-cycle is usable, or why every uncertainty is wide."""

from collections.abc import Sequence
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
_GAP: Final = 3.0
"""Steps between samples."""
_FAST: Final = 1.5
"""Times the swing's frequency."""
_LAST_OVERTONE: Final = 5
_MOST_OF_THE_REST: Final = 0.5
"""Of the power beside the swing; of white noise a line's width holds a fifth at most."""
_SEEN: Final = 3e-4
"""Of the swing's amplitude; below are the last digits of the table, and the sides of the swing's own line."""


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


def fast_oscillation(
    times_ns: NDArray[np.int64],
    deflection: NDArray[np.float64],
    positions: Sequence[NDArray[np.float64]],
    names: Sequence[str],
    period_s: float,
) -> str:
    """What is to be said of a weaker oscillation that most of what is left beside the swing is; else empty.

    It goes into the noise of a sample, and with that into every uncertainty, which name no reason.
    """
    found = _beside_the_swing(times_ns, deflection, period_s)
    if found is None or found[1] < _MOST_OF_THE_REST or found[2] < _SEEN:
        return ""
    line_hz, _, size, _ = found
    where = ""
    if len(positions) > 1:
        each = [_beside_the_swing(times_ns, one, period_s, line_hz) for one in positions]
        absolute = [0.0 if one is None else one[3] for one in each]
        where = f", most of it in {names[int(np.argmax(absolute))]}"
    return (
        f"the samples hold a second oscillation at {line_hz:.3g} Hz, {size:.2g} times as large as the swing"
        f"{where}: it counts as noise of the samples and widens every uncertainty; filter or damp it, or "
        "choose a position that does not see it (--position)"
    )


def _beside_the_swing(
    times_ns: NDArray[np.int64], deflection: NDArray[np.float64], period_s: float, at_hz: float | None = None
) -> tuple[float, float, float, float] | None:
    """Of the strongest line beside swing, overtones and drift, or that at `at_hz`: frequency, share of all
    that is left, amplitude over the swing's, and amplitude; None where there are too few samples.
    """
    good = np.isfinite(deflection)
    time_s, values = seconds(times_ns[good] - times_ns[0]), deflection[good]
    if len(time_s) < _FEWEST:
        return None
    # across a gap a straight line would stand for the swing, and have lines of its own
    steps_s = np.diff(time_s)
    borders = np.flatnonzero(steps_s > _GAP * float(np.median(steps_s))) + 1
    longest = max(np.split(np.arange(len(time_s)), borders), key=len)
    time_s, values = time_s[longest] - time_s[longest[0]], values[longest]
    if len(time_s) < _FEWEST:
        return None
    even_s = np.linspace(0.0, time_s[-1], len(time_s))
    even = np.interp(even_s, time_s, values)
    power = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(len(even)))) ** 2
    span_s = float(even_s[-1])
    turns = span_s / period_s

    def near(k: float) -> slice:
        width = max(_LEAST_BINS, round(_HALF_WIDTH * k))
        return slice(max(round(k) - width, 0), round(k) + width + 1)

    swing = float(power[near(turns)].sum())
    power[: _LEAST_BINS + 1] = 0.0
    for overtone in range(1, _LAST_OVERTONE + 1):
        power[near(overtone * turns)] = 0.0
    # what is slower is the ground or the rest position, which the fits know of, or a side of the swing's line
    power[: round(_FAST * turns)] = 0.0
    rest = float(power.sum())
    if not rest > 0 or not swing > 0:
        return None
    k = int(np.argmax(power)) if at_hz is None else round(at_hz * span_s)
    line = float(power[near(k)].sum())
    return k / span_s, line / rest, (line / swing) ** 0.5, line**0.5
