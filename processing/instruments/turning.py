"""Turning points of large swings, each fitted to the samples around it.

The swing detector assumes the waveform of small swings. That of a pendulum with an amplitude of several
degrees, on a round support and with friction that grows with the angle, is different. Its turning points are
fitted again here, each separately, by a smooth curve with a step of its second derivative at the turning
point, where friction changes its sign. Detection, indices and flags are those of the detector.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.least_squares import FactoredJacobian
from processing.swing import HalfCycle, HalfCycleFlag
from processing.units import seconds

_REACH_HALF_PERIODS = 0.40
"""Half-width of the fitted interval in half periods. Within it even powers up to the sixth approximate a
cosine to 1e-6 of the amplitude."""
_MIN_CENTRES = 4
_POWERS = 7
_TERMS = _POWERS + 1
"""Terms of the fit: the powers 0 to 6, and one for a friction that changes its sign with the motion."""
_MIN_SAMPLES = 2 * _TERMS
"""Fewest samples, which leave as many degrees of freedom as there are terms."""


def refined_turning_points(
    times_ns: Ints, deflection_rad: Floats, u_deflection_rad: Floats, swings: Sequence[HalfCycle]
) -> list[HalfCycle]:
    """The same half-cycles with time and amplitude fitted to the samples around each turning point.

    Parameters
    ----------
    times_ns, deflection_rad, u_deflection_rad
        (n,) samples in which the swings were detected; NaN where the spot was lost.
    swings
        Half-cycles from the detector. One with too few samples around its turning point keeps its values and
        is flagged `HalfCycleFlag.GAP`; flagged ones are returned unchanged.

    Raises
    ------
    DataError
        Fewer than two swings, so that the period is unknown.
    """
    if len(swings) < 2:
        raise DataError(f"{len(swings)} half-cycles; at least 2 are needed to know the period")
    seen = np.isfinite(deflection_rad) & (u_deflection_rad > 0)
    times, values, u = times_ns[seen], deflection_rad[seen], u_deflection_rad[seen]
    length_ns = (swings[-1].turn_time_ns - swings[0].turn_time_ns) / (swings[-1].index - swings[0].index)
    found = [_refined_one(times, values, u, swing, float(length_ns)) for swing in swings]
    found = _about_the_rest_position(found)
    return [*found[:1], *(swing.since(before) for before, swing in pairwise(found))]


def _refined_one(
    times_ns: Ints, values: Floats, u_values: Floats, swing: HalfCycle, half_period_ns: float
) -> HalfCycle:
    if swing.flags:
        return swing
    reach_ns = _REACH_HALF_PERIODS * half_period_ns
    turn_ns = swing.turn_time_ns
    fitted = None
    for _ in range(3):
        # whole numbers: with the ends as floats numpy would convert all the times, for every swing again
        ends_ns = np.array([turn_ns - reach_ns, turn_ns + reach_ns], dtype=np.int64)
        first, last = np.searchsorted(times_ns, ends_ns)
        x = (times_ns[first:last] - turn_ns) / reach_ns
        if len(x) < _MIN_SAMPLES or x[0] > -0.8 or x[-1] < 0.8 or np.max(np.diff(x)) > 0.3:
            return replace(swing, flags=swing.flags | int(HalfCycleFlag.GAP))
        fitted = _fit(x, values[first:last], u_values[first:last])
        shift = -0.5 * fitted[0][1] / fitted[0][2]
        if not abs(shift) < 0.5:
            return replace(swing, flags=swing.flags | int(HalfCycleFlag.GAP))
        turn_ns += round(shift * reach_ns)
    assert fitted is not None
    solution, u_solution = fitted
    return replace(
        swing,
        turn_time_ns=turn_ns,
        u_turn_time_s=float(seconds(abs(0.5 * u_solution[1] / solution[2]) * reach_ns)),
        amplitude=float(abs(solution[0] - swing.centre)),
        u_amplitude=float(u_solution[0]),
    )


def _fit(x: Floats, values: Floats, u_values: Floats) -> tuple[Floats, Floats]:
    """Weighted linear fit; coefficients of 1, x, x^2 and the rest with uncertainties scaled by chi2/dof."""
    design = np.empty((len(x), _TERMS))
    design[:, :_POWERS] = np.vander(x, _POWERS, increasing=True)
    design[:, _POWERS] = x * np.abs(x)
    fit, weighted = FactoredJacobian(design / u_values[:, np.newaxis]), values / u_values
    residual = fit.residual(weighted)
    chi2_per_dof = float(residual @ residual) / (len(x) - _TERMS)
    spread = np.sum(fit.root**2, axis=1)
    return fit.coefficients(weighted), np.sqrt(spread * max(1.0, chi2_per_dof))


def _about_the_rest_position(swings: list[HalfCycle]) -> list[HalfCycle]:
    """Amplitudes relative to the rest position, a straight line in time fitted to all turning points.

    Three successive turning points whose amplitudes form a geometric series determine it exactly.
    """
    good = [swing for swing in swings if not swing.flags]
    triples = [
        (a, b, c)
        for a, b, c in zip(good, good[1:], good[2:], strict=False)
        if c.index - a.index == 2 and b.index - a.index == 1
    ]
    if len(triples) < _MIN_CENTRES:
        return swings
    place = {swing.index: swing.centre + swing.side * swing.amplitude for swing in good}
    time_s = np.array([seconds(b.turn_time_ns - good[0].turn_time_ns) for _, b, _ in triples])
    before, turn, after = (
        np.array([place[swing.index] for swing in row]) for row in zip(*triples, strict=True)
    )
    middle = (before * after - turn**2) / (before + after - 2 * turn)
    slope, rest = np.polyfit(time_s, middle, 1)
    result = []
    for swing in swings:
        if swing.flags:
            result.append(swing)
            continue
        centre = float(rest + seconds(slope * (swing.turn_time_ns - good[0].turn_time_ns)))
        result.append(replace(swing, centre=centre, amplitude=abs(place[swing.index] - centre)))
    return result
