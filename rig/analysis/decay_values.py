"""What every decay has, whether or not a law can be fitted: period, decrement, damping, in its own unit."""

from dataclasses import fields, replace
from math import hypot, pi
from typing import Any

from processing.damping import fit_damping
from processing.decay_summary import DecaySummary, summarise_decay
from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints
from rig.analysis.amplitude_damping import (
    AmplitudeDamping,
    DampingAt,
    amplitude_damping,
    damping_lines,
)
from rig.analysis.results import RunResults
from rig.presentation import with_uncertainty


def decay_values(
    points: TurningPoints,
    summary: DecaySummary,
    unit_size: float,
    *,
    u_clock: float = 0.0,
    u_common: float = 0.0,
) -> dict[str, Any]:
    """Fields of `RunResults`; amplitudes in a unit that is `unit_size` in that of the points.

    `u_clock` is what the second of the times is uncertain by, relative; `u_common` the standard uncertainty
    of an error that all half-cycles share, in the unit of the points: of their amplitudes, and as a lag of
    the position where the swing turns, of their times. What it would change is in the uncertainties.
    """
    found = _of(points, summary, unit_size)
    period_s, u_s = found["period_s"]
    found["period_s"] = Estimate(period_s, hypot(u_s, u_clock * period_s))
    if not u_common > 0:
        return found
    lag_s = u_common * period_s / (2.0 * pi * points.amplitude)
    moved = replace(points, amplitude=points.amplitude + u_common, time_s=points.time_s + lag_s)
    other = _of(moved, summarise_decay(moved), unit_size)
    return {name: _wider(value, other[name]) for name, value in found.items()}


def _of(points: TurningPoints, summary: DecaySummary, unit_size: float) -> dict[str, Any]:
    return {
        "period_s": Estimate(summary.period_s.value, summary.period_s.u),
        "log_decrement": Estimate(summary.decrement.value, summary.decrement.u),
        "quality_factor": summary.quality_factor,
        "damping": _damping(points, summary, unit_size),
    }


def values_of_points(points: TurningPoints, unit_size: float, u_clock: float = 0.0) -> dict[str, Any]:
    """The same of turning points alone; nothing where there are too few of them."""
    try:
        return decay_values(points, summarise_decay(points), unit_size, u_clock=u_clock)
    except DataError:
        return {}


def decay_lines(results: RunResults) -> list[str]:
    """Lines for a person; none of a run without them."""
    if not results.period_s.value > 0:
        return []
    lines = [
        f"period {with_uncertainty(*results.period_s)} s",
        f"log decrement {with_uncertainty(*results.log_decrement)}",
    ]
    if results.quality_factor is not None:
        lines.append(f"quality factor {with_uncertainty(*results.quality_factor)}")
    if results.damping is not None:
        lines += damping_lines(results.damping, results.amplitude_unit or "")
    return lines


def _wider(found: Any, other: Any) -> Any:
    """An estimate, or the damping with all of its estimates, with the change to another one in its u."""
    if isinstance(found, Estimate):
        if other is None:
            return found
        return Estimate(found.value, hypot(found.standard_uncertainty, other.value - found.value))
    if isinstance(found, AmplitudeDamping | DampingAt) and other is not None:
        names = [each.name for each in fields(found)]
        changed = {
            name: _wider(getattr(found, name), getattr(other, name))
            for name in names
            if isinstance(getattr(found, name), Estimate)
        }
        if isinstance(found, AmplitudeDamping) and len(found.curve) == len(other.curve):
            changed["curve"] = tuple(map(_wider, found.curve, other.curve))
        return replace(found, **changed)
    return found


def _damping(points: TurningPoints, summary: DecaySummary, unit_size: float) -> AmplitudeDamping | None:
    try:
        found = fit_damping(points.time_s, points.amplitude / unit_size, points.u_amplitude / unit_size)
    except DataError:
        return None
    return amplitude_damping(found, 1.0 / summary.period_s.value)
