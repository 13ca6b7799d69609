"""One run of a pendulum that swings by degrees: turning points, report, conditions of the standard."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import points_in_true_time
from processing.instruments import (
    DEGREE_RAD,
    INSTRUMENTS,
    Check,
    Description,
    Limits,
    Reading,
    SharedError,
    check,
    inferred_swings,
    joined_swings,
    refined,
    with_release,
)
from processing.surroundings import Surroundings
from processing.swing import Swing, SwingFlag, TurningPoints
from processing.ticks import seconds
from rig.analysis.instrument_results import (
    InstrumentResults,
    SwingPlane,
)
from rig.analysis.reports_by_kind import range_and_period, report_of_kind
from rig.analysis.turning_plane import FollowedPlane
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings

_FELT: Final = 0.01
"""Error of an amplitude, in its uncertainties, below which it changes nothing that is reported."""


@dataclass(frozen=True, slots=True)
class Reduction:
    """One run as its kind of pendulum is reported.

    `problem` is the one line that says what could not be had; `values` holds what could, its text in lines.
    `points` were made of `swings`. `readings` are what a series compares, empty where there is none.
    """

    settings: InstrumentSettings
    values: InstrumentResults
    points: TurningPoints
    swings: Sequence[Swing]
    problem: str = ""
    readings: Mapping[str, Reading] = field(default_factory=dict)


def reduce_run(
    settings: InstrumentSettings,
    followed: FollowedPlane,
    air: Surroundings,
    errors: Sequence[SharedError] = (),
    clock_rate: float = 1.0,
) -> Reduction:
    """Reduce the half-cycles of one run of a pendulum that swings by degrees.

    Parameters
    ----------
    followed
        Half-cycles of the detector, and the deflections that they were detected in, in rad, both in the plane
        of swing. With deflections the turning points are fitted again by a waveform that holds at degrees.
    errors
        That all turning points of the run have alike, and other runs perhaps as well.
    clock_rate
        True seconds in one of the deflections' clock.
    """
    description = settings.description()
    values = InstrumentResults(kind=description.kind)
    lines = [f"{description.kind}: {description.sentence}"]
    problems = [followed.problem] if followed.problem else []
    if description.turning_plane or followed.is_turned:
        values = replace(values, swing_plane=_swing_plane(followed, lines))
    swings = followed.swings
    deflections = joined(followed.deflections, DeflectionUnit.RAD)
    if len(deflections):
        if len(swings) > 1:
            swings = refined(deflections.times_ns, deflections.y, deflections.u_y, swings)
        swings, inferred = _with_inferred(swings, deflections, lines)
        values = replace(values, inferred_half_cycles=inferred)
        if description.report == "hardness":
            swings = _from_the_release(swings, deflections, lines)
    points = points_in_true_time(swings, clock_rate)
    errors = [*errors, *_errors_of_plane(followed, points)]
    readings: Mapping[str, Reading] = {}
    try:
        if followed.problem:
            raise DataError(followed.problem)
        values, readings = report_of_kind(description, settings, points, values, lines, errors)
    except DataError as error:
        problems.append(str(error))
        values = range_and_period(points, values, lines)
    checks = _held_against_air(description, air, lines)
    values = replace(
        values, environment=checks or None, apparatus=_check_mass(settings, lines), text=tuple(lines)
    )
    return Reduction(settings, values, points, swings, "; ".join(dict.fromkeys(problems)), readings)


def _swing_plane(followed: FollowedPlane, lines: list[str]) -> SwingPlane | None:
    plane = followed.plane
    if plane is None:
        lines.append("the plane of swing is not known: too few periods were seen along both axes")
        return None
    rate = Estimate(plane.mean_rate(), plane.u_mean_rate())
    per_minute, turned_deg = (
        Estimate(*(factor / DEGREE_RAD * value for value in rate))
        for factor in (60.0, seconds(followed.swings[-1].turn_time_ns - plane.start_ns))
    )
    lines.append(
        f"the swing plane turns by {with_uncertainty(*per_minute)} degrees/min, "
        f"{turned_deg.value:.3g} degrees in all"
    )
    angles = np.unwrap([one.line_angle_rad for one in followed.balances], period=math.pi)
    times_ns = np.array([one.time_ns for one in followed.balances])
    return SwingPlane(
        angles / DEGREE_RAD,
        seconds(times_ns - plane.start_ns),
        per_minute,
        turned_deg,
        max(one.width_ratio for one in followed.balances),
    )


def _errors_of_plane(followed: FollowedPlane, points: TurningPoints) -> list[SharedError]:
    """What is not known of the plane, which is each run's own."""
    columns = followed.amplitude_errors(points)
    if columns is None:
        return []
    felt = np.max(np.abs(columns) / points.u_amplitude[:, None], axis=0) > _FELT
    return [SharedError("", amplitude_rad=column) for column in columns.T[felt]]


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


def _from_the_release(swings: Sequence[Swing], deflections: Deflections, lines: list[str]) -> Sequence[Swing]:
    """With the release as the first turning point, where it was recorded; that it was not is said."""
    found = with_release(deflections.times_ns, deflections.y, deflections.u_y, swings)
    if found is not None:
        at_s, u_s = seconds(found[0].turn_time_ns - deflections.times_ns[0]), found[0].u_turn_time_s
        angle = with_uncertainty(found[0].amplitude / DEGREE_RAD, found[0].u_amplitude / DEGREE_RAD)
        lines.append(
            f"released {with_uncertainty(float(at_s), u_s)} s after the first sample, at {angle} degrees"
        )
        return found
    if any(swing.flags & SwingFlag.START for swing in swings):
        lines.append(
            "the release itself is disturbed or was not recorded: the first swing is that from the first "
            "turning point seen"
        )
    return swings


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
