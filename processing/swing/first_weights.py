"""Uncertainties of the first half-cycles, from the noise that is learned later.

Slow noise, of air or a pointing that walks, and what a drive does within a half-cycle are seen only after
some half-cycles (`noise`, `driven_walk`). Until then turning points stand with what white noise of the
samples leaves them, a tenth of what is true in a basement, and a fit would hang on the first ones. What a
half-cycle says is known live stays; a fit, which comes later, knows better.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from processing.swing.swing import Swing

_LEARNED = 63
"""Half-cycles without a flag after which the noise counts as learned: so many it is learned from."""
_KNOWING = 15
"""Number of half-cycles whose median says what was learned; the last ones, where there are no later."""


def with_learned_weights(swings: Sequence[Swing]) -> list[Swing]:
    """The half-cycles, with uncertainties of the first ones that are no smaller than those learned from them.

    Amplitude and time count apart. The time's uncertainty is compared as that of the arc, amplitude times
    time, which the same noise leaves at every amplitude. Noise that is smaller in the beginning, or learned
    at once, changes nothing.
    """
    good = [number for number, swing in enumerate(swings) if not swing.flags]
    first = max(0, min(_LEARNED, len(good) - _KNOWING))
    knowing = [swings[number] for number in good[first : first + _KNOWING]]
    if not first:
        return list(swings)
    least = float(np.median([swing.u_amplitude for swing in knowing]))
    least_arc = float(np.median([swing.u_turn_time_s * swing.amplitude for swing in knowing]))
    out: list[Swing] = []
    early = set(good[:first])
    for number, swing in enumerate(swings):
        if number in early:
            swing = replace(
                swing,
                u_amplitude=max(swing.u_amplitude, least),
                u_turn_time_s=max(swing.u_turn_time_s, least_arc / swing.amplitude),
            )
        follows = number in early or (number - 1 in early and not swing.flags)
        if out and follows and math.isfinite(swing.u_half_period_s):
            swing = replace(swing, u_half_period_s=math.hypot(swing.u_turn_time_s, out[-1].u_turn_time_s))
        out.append(swing)
    return out
