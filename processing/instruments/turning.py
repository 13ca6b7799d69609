"""Turning points of large amplitudes, each fitted to the samples around it.

The detector of half-cycles assumes the waveform of small amplitudes. That of a pendulum with an amplitude of
several degrees, on a round support and with friction that grows with the angle, is different. Its turning
points are fitted again here, each separately, by a smooth curve with a step of its second derivative at the
turning point, where friction changes its sign. Indices and flags are those of the detector.
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
cosine to 1e-6 of the amplitude.
"""
_MIN_CENTRES = 4
_POWERS = 7
_TERMS = _POWERS + 1
"""Terms of the fit: the powers 0 to 6, and one for a friction that changes its sign with the motion."""
_MIN_SAMPLES = 2 * _TERMS
"""Smallest number of samples, which leaves as many degrees of freedom as there are terms."""


def refined_turning_points(
    times_ns: Ints, deflection_rad: Floats, u_deflection_rad: Floats, half_cycles: Sequence[HalfCycle]
) -> list[HalfCycle]:
    """The same half-cycles with time and amplitude fitted to the samples around each turning point.

    Parameters
    ----------
    times_ns, deflection_rad, u_deflection_rad
        (n,) samples in which the half-cycles were detected; NaN where the spot was lost.
    half_cycles
        Half-cycles from the detector. One with too few samples around its turning point is only flagged as
        `HalfCycleFlag.GAP`; flagged ones are returned unchanged.

    Raises
    ------
    DataError
        Fewer than two half-cycles, so that the period is unknown.
    """
    if len(half_cycles) < 2:
        raise DataError(f"{len(half_cycles)} half-cycles; at least 2 are needed to know the period")
    has_spot = np.isfinite(deflection_rad) & (u_deflection_rad > 0)
    samples = times_ns[has_spot], deflection_rad[has_spot], u_deflection_rad[has_spot]
    first, last = half_cycles[0], half_cycles[-1]
    half_period_ns = (last.turn_time_ns - first.turn_time_ns) / (last.index - first.index)
    refined = [_refined(*samples, half_cycle, float(half_period_ns)) for half_cycle in half_cycles]
    refined = _relative_to_rest(refined)
    return [*refined[:1], *(following.since(preceding) for preceding, following in pairwise(refined))]


def _refined(
    times_ns: Ints, values: Floats, u_values: Floats, half_cycle: HalfCycle, half_period_ns: float
) -> HalfCycle:
    if half_cycle.flags:
        return half_cycle
    reach_ns = _REACH_HALF_PERIODS * half_period_ns
    turn_ns = half_cycle.turn_time_ns
    for _ in range(3):
        # whole numbers: with the ends as floats numpy would convert all the times, for every half-cycle again
        ends_ns = np.array([turn_ns - reach_ns, turn_ns + reach_ns], dtype=np.int64)
        first, last = np.searchsorted(times_ns, ends_ns)
        x = (times_ns[first:last] - turn_ns) / reach_ns
        if len(x) < _MIN_SAMPLES or x[0] > -0.8 or x[-1] < 0.8 or np.max(np.diff(x)) > 0.3:
            return replace(half_cycle, flags=int(HalfCycleFlag.GAP))
        solution, u_solution = _fit(x, values[first:last], u_values[first:last])
        shift = -0.5 * solution[1] / solution[2]
        if not abs(shift) < 0.5:
            return replace(half_cycle, flags=int(HalfCycleFlag.GAP))
        turn_ns += round(shift * reach_ns)
    return replace(
        half_cycle,
        turn_time_ns=turn_ns,
        u_turn_time_s=float(seconds(abs(0.5 * u_solution[1] / solution[2]) * reach_ns)),
        amplitude=float(abs(solution[0] - half_cycle.centre)),
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
    variance = np.sum(fit.root**2, axis=1)
    return fit.coefficients(weighted), np.sqrt(variance * max(1.0, chi2_per_dof))


def _relative_to_rest(half_cycles: list[HalfCycle]) -> list[HalfCycle]:
    """Amplitudes relative to the rest position, a straight line in time through all turning points: three
    successive ones whose amplitudes form a geometric series determine it exactly."""
    good = [half_cycle for half_cycle in half_cycles if not half_cycle.flags]
    triples = [
        (a, b, c)
        for a, b, c in zip(good, good[1:], good[2:], strict=False)
        if c.index - a.index == 2 and b.index - a.index == 1
    ]
    if len(triples) < _MIN_CENTRES:
        return half_cycles
    start_ns = good[0].turn_time_ns
    time_s = np.array([seconds(b.turn_time_ns - start_ns) for _, b, _ in triples])
    first, second, third = np.array([[_turn(half_cycle) for half_cycle in triple] for triple in triples]).T
    slope, rest = np.polyfit(time_s, (first * third - second**2) / (first + third - 2 * second), 1)
    result = []
    for half_cycle in half_cycles:
        if not half_cycle.flags:
            centre = float(rest + seconds(slope * (half_cycle.turn_time_ns - start_ns)))
            amplitude = abs(_turn(half_cycle) - centre)
            half_cycle = replace(half_cycle, centre=centre, amplitude=amplitude)
        result.append(half_cycle)
    return result


def _turn(half_cycle: HalfCycle) -> float:
    """Deflection at the turning point."""
    return half_cycle.centre + half_cycle.side * half_cycle.amplitude
