"""Separation of the half-cycles of several decays that one record holds, one after another."""

from collections.abc import Sequence
from math import hypot

from processing.swing import Swing, SwingFlag

_GROWN = 1.2
"""Ratio of neighbouring amplitudes from which on the pendulum was pushed again, and did not merely swing a
little further: 20 % of its amplitude are nearly half of its energy."""
_CLEARLY = 6.0
"""Standard uncertainties: by chance once in 10^9 half-cycles, where amplitudes are so faint that noise makes
them grow."""


def separate_decays(swings: Sequence[Swing]) -> list[list[Swing]]:
    """The half-cycles of every decay, in order.

    A decay begins with the first half-cycle, with one in which the detector saw a release or a kick, and
    where an amplitude is clearly larger than the one before.
    """
    decays: list[list[Swing]] = []
    before: Swing | None = None
    for swing in swings:
        released = bool(swing.flags & SwingFlag.START) and before is not None
        if not decays or released or (before is not None and _pushed(before, swing)):
            decays.append([])
            before = None
        decays[-1].append(swing)
        if not swing.flags:
            before = swing
    return decays


def _pushed(before: Swing, swing: Swing) -> bool:
    """Whether an unflagged half-cycle is clearly larger than the unflagged one before it."""
    grown = swing.amplitude - before.amplitude
    return (
        not swing.flags
        and swing.amplitude > _GROWN * before.amplitude
        and grown > _CLEARLY * hypot(swing.u_amplitude, before.u_amplitude)
    )
