"""One run of a pendulum that swings by degrees: turning points, report, conditions of the standard."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from processing.deflections import Deflections
from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments import (
    DEGREE_RAD,
    INSTRUMENTS,
    Check,
    Damping,
    Description,
    Limits,
    along_plane,
    check,
    inferred_swings,
    joined_swings,
    refined,
    swing_plane,
)
from processing.periods import mean_period
from processing.surroundings import Surroundings
from processing.swing import Swing, SwingFlag, TurningPoints, swings_of, turning_points
from rig.analysis.instrument_results import (
    InstrumentResults,
    SwingPlane,
)
from rig.analysis.reports_by_kind import range_and_period, report_of_kind
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings


@dataclass(frozen=True, slots=True)
class Reduction:
    """One run as its kind of pendulum is reported.

    `problem` is the one line that says what could not be had; `values` holds what could, its text in lines.
    `points` were made of `swings`.
    """

    settings: InstrumentSettings
    values: InstrumentResults
    points: TurningPoints
    swings: Sequence[Swing]
    problem: str = ""
    damping: Damping | None = None
    air: Surroundings = field(default_factory=Surroundings)


def reduce_run(
    settings: InstrumentSettings,
    swings: Sequence[Swing],
    deflections: Deflections | None,
    air: Surroundings,
    u_scale_relative: float = 0.0,
) -> Reduction:
    """Reduce the half-cycles of one run of a pendulum that swings by degrees.

    Parameters
    ----------
    swings
        Of the detector.
    deflections
        Those that they were detected in, in rad. With them the turning points are fitted again by a
        waveform that holds at degrees, and a plane that turns is followed; None: swings as they are.
    u_scale_relative
        Relative standard uncertainty of the lever's scale, which all amplitudes share.
    """
    description = settings.description()
    values = InstrumentResults(kind=description.kind)
    lines = [f"{description.kind}: {description.sentence}"]
    problems: list[str] = []
    if deflections is not None and len(swings) > 1:
        if description.turning_plane:
            try:
                swings, deflections, plane = _in_its_plane(swings, deflections, lines)
                values = replace(values, swing_plane=plane)
            except DataError as error:
                problems.append(str(error))
        swings = refined(deflections.times_ns, deflections.y, deflections.u_y, swings)
    if deflections is not None:
        swings, inferred = _with_inferred(swings, deflections, lines)
        values = replace(values, inferred_half_cycles=inferred)
    points = turning_points(swings)
    found: Damping | None = None
    try:
        values, found = report_of_kind(description, settings, points, values, lines, u_scale_relative)
    except DataError as error:
        problems.append(str(error))
        values = range_and_period(points, values, lines)
    checks = _held_against_air(description, air, lines)
    values = replace(
        values, environment=checks or None, apparatus=_check_mass(settings, lines), text=tuple(lines)
    )
    return Reduction(settings, values, points, swings, "; ".join(problems), found, air)


def _with_inferred(
    swings: Sequence[Swing], deflections: Deflections, lines: list[str]
) -> tuple[Sequence[Swing], int | None]:
    """Half-cycles whose turning point lay off the sensor are added; how many, None where none is."""
    off = inferred_swings(deflections.times_ns, deflections.y, deflections.u_y)
    if not off:
        return swings, None
    joined = joined_swings(swings, off)
    kept = sum(bool(swing.flags & SwingFlag.INFERRED) for swing in joined)
    lines.append(
        f"{kept} of {len(joined)} turning points lay off the sensor, inferred from the crossings' speeds"
    )
    return [replace(swing, flags=swing.flags & ~int(SwingFlag.INFERRED)) for swing in joined], kept


def _in_its_plane(
    swings: Sequence[Swing], deflections: Deflections, lines: list[str]
) -> tuple[Sequence[Swing], Deflections, SwingPlane]:
    """Swings and deflections along the plane that turns."""
    period_s = mean_period(turning_points(swings)) if len(turning_points(swings)) > 1 else math.nan
    if not period_s > 0:
        raise DataError("no period is known; the swing plane cannot be followed")
    at = deflections
    plane = swing_plane(at.times_ns, at.x, at.y, period_s)
    y, u_y = along_plane(plane, at.times_ns, at.x, at.y, at.u_x, at.u_y)
    found = swings_of(at.times_ns, y, u_y)
    per_minute = Estimate(*(60 * value / DEGREE_RAD for value in plane.rate_rad_per_s))
    turned_deg = Estimate(*(value / DEGREE_RAD for value in plane.turned_rad))
    lines.append(
        f"the swing plane turns by {with_uncertainty(*per_minute)} degrees/min, "
        f"{turned_deg.value:.3g} degrees in all"
    )
    reported = SwingPlane(
        plane.direction_rad / DEGREE_RAD, plane.time_s, per_minute, turned_deg, plane.width_ratio
    )
    return found, replace(deflections, y=y, u_y=u_y), reported


def _held_against_air(description: Description, air: Surroundings, lines: list[str]) -> tuple[Check, ...]:
    wanted = (
        ("temperature", air.temperature_c, description.temperature_c, "°C"),
        ("humidity", air.humidity_percent, description.humidity_percent, "%"),
    )
    found = []
    for name, value, limits, unit in wanted:
        if limits is None:
            continue
        if math.isnan(value):
            lines.append(
                f"{name} is not known; the standard wants {limits.value:g} ± {limits.tolerance:g} {unit}"
            )
            continue
        item = check(name, Estimate(value, 0.0), limits, unit)
        found.append(item)
        lines.append(item.text)
    return tuple(found)


def _check_mass(settings: InstrumentSettings, lines: list[str]) -> tuple[Check, ...] | None:
    """The stated mass of the pendulum against the standard's, where the standard limits it."""
    standard = INSTRUMENTS[settings.kind]
    if settings.mass_kg is None or standard.mass_kg is None or standard.mass_tolerance_kg is None:
        return None
    limits = Limits(standard.mass_kg, standard.mass_tolerance_kg)
    item = check("mass of the pendulum", Estimate(settings.mass_kg, 0.0), limits, "kg")
    lines.append(item.text)
    return (item,)
