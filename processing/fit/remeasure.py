"""Turning points measured again from the samples, once a fit has told the motion between them.

A swing detector knows the motion only from the half-cycles so far: the earliest are measured with what
little there was, and what it got wrong about friction or stiffness shifts many turning times together, by
a part of their uncertainty each, which no fit averages out. A fit to all of them knows it from the
whole decay. Measured again with that, the turning points have errors of their own alone.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.contact import ContactParameters, PendulumOnBall, scaled_contact
from processing.errors import DataError
from processing.swing import KnownMotion, Swing, SwingDetector, SwingFlag

_MOST = 0.95
"""Part of the half-cycles that must be found again ..."""

_SHIFTED = 0.75
"""... and the root mean square of their shifts, in standard uncertainties, up to which they agree."""


def known_motion(
    parameters: ContactParameters, pendulum: PendulumOnBall, reference_rad: float, clock: float = 1.0
) -> KnownMotion:
    """The half-swing that the parameters make, for deflections in rad.

    Parameters
    ----------
    reference_rad
        Amplitude about which it is written down; any within the decay.
    clock
        True seconds, in which the parameters count, per second of the samples' clock.

    Raises
    ------
    DataError
        The pendulum would not swing at the reference amplitude, or a parameter is not known.

    Notes
    -----
    Eq. 4 with Eqs. 1 and 3 and a drag, ``x = phi/reference`` and the terms of `scaled_contact`, is
    ``x'' = w0^2 (-x + kappa x (pi/2 |x|^n - rho |x|^(n+1)) - sign(x') (c + b |x|^p) - drag x'/w0)``. The
    waveform counts its frequency from the stiffness at the reference and its powers from 1 there.
    """
    contact = scaled_contact(parameters, pendulum, reference_rad)
    softening, hardening = 0.5 * math.pi * contact.kappa, contact.kappa * contact.rho
    stiffness = 1.0 - softening + hardening
    if not stiffness > 0.0:
        raise DataError(f"adhesion takes all of the stiffness at {reference_rad:.3g} rad: there is no swing")
    rate = 2.0 * math.pi / parameters.period0_s * math.sqrt(stiffness)
    of_n = contact.n * softening / stiffness
    of_next = -(1.0 + contact.n) * hardening / stiffness
    return KnownMotion(
        rate_rad_per_s=rate * clock,
        reference=reference_rad,
        damping=0.5 * contact.drag / math.sqrt(stiffness),
        dry=(contact.c + contact.b) / stiffness,
        rise=contact.p * contact.b / stiffness,
        p=contact.p,
        stiff=of_n + of_next,
        n=contact.n,
        bend=of_next + (of_n + of_next) * contact.n,
    )


def measured_again(
    swings: Sequence[Swing],
    times_ns: NDArray[np.int64],
    deflection_rad: NDArray[np.float64],
    u_deflection_rad: NDArray[np.float64],
    motion: KnownMotion,
) -> list[Swing]:
    """The same half-cycles, each fitted to its samples once more, on a known motion.

    Parameters
    ----------
    swings
        Of the detector, in order. Flagged ones are handed on as they are; one that is not found again, or
        found disturbed, is flagged.
    times_ns, deflection_rad, u_deflection_rad
        (n,) the samples that they were detected in; NaN where the spot was lost.
    """
    detector = SwingDetector(motion)
    found = [*detector.update(times_ns, deflection_rad, u_deflection_rad), *detector.finish()]
    found_ns = np.array([swing.turn_time_ns for swing in found], dtype=np.int64)
    near_ns = 0.25e9 * math.pi / motion.rate_rad_per_s
    again: list[Swing] = []
    for swing in swings:
        if swing.flags == 0:
            twin = _nearest(found, found_ns, swing.turn_time_ns)
            if twin is None or abs(twin.turn_time_ns - swing.turn_time_ns) > near_ns:
                swing = replace(swing, flags=int(SwingFlag.GAP))
            else:
                before = again[-1] if again and again[-1].index == swing.index - 1 else None
                swing = replace(
                    twin,
                    index=swing.index,
                    half_period_s=(twin.turn_time_ns - before.turn_time_ns) * 1e-9 if before else math.nan,
                    u_half_period_s=math.hypot(twin.u_turn_time_s, before.u_turn_time_s)
                    if before
                    else math.nan,
                )
        again.append(swing)
    return again


def _nearest(swings: Sequence[Swing], times_ns: NDArray[np.int64], time_ns: int) -> Swing | None:
    if not len(times_ns):
        return None
    after = min(int(np.searchsorted(times_ns, time_ns)), len(times_ns) - 1)
    before = max(after - 1, 0)
    nearer = before if time_ns - times_ns[before] < times_ns[after] - time_ns else after
    return swings[nearer]


def agree(swings: Sequence[Swing], again: Sequence[Swing]) -> bool:
    """Whether half-cycles measured again lie where they lay, within what was claimed for them.

    Where they do, they differ by what the detector had yet to learn: 0.1 to 0.5 of a standard uncertainty.
    They do not where the fitted laws are not those of the motion, or leave open what matters within a
    half-cycle (friction against drag); what the detector learned from the samples is then better knowledge.
    """
    pairs = [(a, b) for a, b in zip(swings, again, strict=True) if a.flags == 0]
    both = [(a, b) for a, b in pairs if b.flags == 0]
    if len(both) < _MOST * len(pairs) or not both:
        return False
    time = [(b.turn_time_ns - a.turn_time_ns) * 1e-9 / a.u_turn_time_s for a, b in both]
    amplitude = [(b.amplitude - a.amplitude) / a.u_amplitude for a, b in both]
    return all(math.sqrt(float(np.mean(np.square(shift)))) < _SHIFTED for shift in (time, amplitude))
