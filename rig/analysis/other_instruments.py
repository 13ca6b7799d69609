"""What is reported of a kind of pendulum: values for results.json, lines for the terminal."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from processing.contact import measured_losses
from processing.deflections import Deflections
from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments import (
    DEGREE_RAD,
    INSTRUMENTS,
    Damping,
    Description,
    FrictionLaw,
    Limits,
    along_plane,
    check,
    circular_error,
    damping,
    fit_friction_law,
    herbert_hardness,
    inferred_swings,
    joined_swings,
    refined,
    rolling_friction,
    swing_plane,
    with_scale,
)
from processing.periods import mean_period
from processing.swing import Swing, SwingDetector, SwingFlag, TurningPoints, turning_points
from rig.analysis.instrument_results import (
    CheckedValue,
    DampingResults,
    DecrementTable,
    FrictionLawResults,
    InstrumentResults,
    PeriodTable,
    SwingPlane,
)
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings


@dataclass(frozen=True, slots=True)
class Air:
    """Mean temperature and humidity of a run; NaN for what is not known."""

    temperature_c: float = math.nan
    humidity_percent: float = math.nan


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
    air: Air = field(default_factory=Air)


def reduce_run(
    settings: InstrumentSettings,
    swings: Sequence[Swing],
    deflections: Deflections | None,
    air: Air,
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
        values, found = _reduce(description, settings, points, values, lines, u_scale_relative)
    except DataError as error:
        problems.append(str(error))
        values = _what_is_left(points, values, lines)
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


def _reduce(
    description: Description,
    settings: InstrumentSettings,
    points: TurningPoints,
    values: InstrumentResults,
    lines: list[str],
    u_scale: float,
) -> tuple[InstrumentResults, Damping | None]:
    """The values with what this kind reports; lines are added. Raises DataError where it cannot be had."""
    if description.report == "hardness":
        return _hardness(settings, points, values, lines, u_scale), None
    if description.report == "circular":
        return _circular(points, values, lines, u_scale), None
    if description.report == "rolling":
        return _rolling(description, settings, points, values, lines, u_scale), None
    if description.report == "decay":
        values = _decrements(points, values, lines)
    found = with_scale(
        lambda at: damping(at, description.start_amplitude_rad, description.end_amplitude_rad),
        points,
        u_scale,
    )
    start_deg, end_deg = found.start_rad / DEGREE_RAD, found.end_rad / DEGREE_RAD
    lines.append(
        f"from {start_deg:g} to {end_deg:g} degrees: damping time "
        f"{with_uncertainty(*found.time_s)} s, {with_uncertainty(*found.swings)} swings"
    )
    reported = DampingResults(start_deg, end_deg, found.time_s, found.swings, found.missing)
    return replace(values, damping=reported), found


def _hardness(
    settings: InstrumentSettings,
    points: TurningPoints,
    values: InstrumentResults,
    lines: list[str],
    u_scale: float,
) -> InstrumentResults:
    hardness = with_scale(lambda at: herbert_hardness(at, settings.scale_divisions), points, u_scale)
    if hardness.ten_swings_s is not None:
        lines.append(f"time hardness (ten single swings) {with_uncertainty(*hardness.ten_swings_s)} s")
    else:
        lines.append(hardness.missing)
    lines.append(
        f"time hardness (first swing x 10) {with_uncertainty(*hardness.first_swing_times_ten_s)} s, "
        f"scale hardness {with_uncertainty(*hardness.scale_hardness)} of {settings.scale_divisions:g}"
    )
    return replace(
        values,
        first_amplitude_deg=hardness.first_amplitude_rad / DEGREE_RAD,
        time_hardness_first_swing_s=hardness.first_swing_times_ten_s,
        scale_hardness=hardness.scale_hardness,
        time_hardness_s=hardness.ten_swings_s,
        problem=hardness.missing if hardness.ten_swings_s is None else None,
    )


def _circular(
    points: TurningPoints, values: InstrumentResults, lines: list[str], u_scale: float
) -> InstrumentResults:
    law = with_scale(circular_error, points, u_scale)
    lines += [f"period at vanishing amplitude {with_uncertainty(*law.period0_s)} s", law.sentence]
    return replace(
        values,
        period0_s=law.period0_s,
        circular_factor=law.factor,
        chi2_per_dof=law.chi2_per_dof,
        table=PeriodTable(
            law.amplitude_rad / DEGREE_RAD, law.period_s, law.u_period_s, law.law_s, law.sixteenth_s
        ),
    )


def _rolling(
    description: Description,
    settings: InstrumentSettings,
    points: TurningPoints,
    values: InstrumentResults,
    lines: list[str],
    u_scale: float,
) -> InstrumentResults:
    lever = description.lever_m and Estimate(description.lever_m, settings.u_lever_m)
    radius = description.support_radius_m and Estimate(
        description.support_radius_m, settings.u_support_radius_m
    )
    found = with_scale(lambda at: rolling_friction(at, lever or None, radius or None), points, u_scale)
    at = found.law.reference_rad / DEGREE_RAD
    lines.append(f"log decrement at {at:.4g} degrees {with_uncertainty(*found.decrement)}")
    problem = None
    if found.coefficient is not None:
        lines.append(
            f"rolling-friction coefficient at {at:.4g} degrees {with_uncertainty(*found.coefficient)}"
        )
    else:
        problem = "no rolling-friction coefficient: state instrument.lever_m and instrument.support_radius_m"
        lines.append(problem)
    lines += found.sentences
    return replace(
        values,
        friction_law=_law(found.law),
        log_decrement=found.decrement,
        constant_decrement=found.constant_decrement,
        independent_of_speed=found.independent_of_speed,
        rolling_friction_coefficient=found.coefficient,
        problem=problem,
        decrement_against_amplitude=_losses(points),
    )


def _decrements(points: TurningPoints, values: InstrumentResults, lines: list[str]) -> InstrumentResults:
    law = fit_friction_law(points)
    decrement = law.decrement(law.reference_rad)
    lines.append(
        f"log decrement at {law.reference_rad / DEGREE_RAD:.4g} degrees {with_uncertainty(*decrement)}, "
        f"friction goes as amplitude^({with_uncertainty(*law.exponent)})"
    )
    return replace(
        values,
        friction_law=_law(law),
        log_decrement=decrement,
        decrement_against_amplitude=_losses(points),
    )


def _law(law: FrictionLaw) -> FrictionLawResults:
    return FrictionLawResults(law.reference_rad / DEGREE_RAD, law.moment, law.exponent, law.chi2_per_dof)


def _losses(points: TurningPoints) -> DecrementTable:
    cycles = max(1, int(points.index[-1] - points.index[0]) // 40)
    losses = measured_losses(points, cycles=cycles)
    return DecrementTable(losses.amplitude_rad / DEGREE_RAD, losses.log_decrement, losses.u_log_decrement)


def _what_is_left(points: TurningPoints, values: InstrumentResults, lines: list[str]) -> InstrumentResults:
    """Range and period, which may be had where the quantity asked for cannot."""
    if len(points) < 2:
        return values
    first, last = (float(points.amplitude[at]) / DEGREE_RAD for at in (0, -1))
    lines.append(
        f"what there is: {len(points)} half-cycles from {first:.4g} to {last:.4g} degrees, "
        f"mean period {mean_period(points):.6g} s"
    )
    return replace(values, amplitude_deg=(first, last), mean_period_s=mean_period(points))


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
    detector = SwingDetector()
    found = detector.update(at.times_ns, y, u_y) + detector.finish()
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


def _held_against_air(description: Description, air: Air, lines: list[str]) -> tuple[CheckedValue, ...]:
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
        found.append(CheckedValue.of(item))
        lines.append(item.text)
    return tuple(found)


def _check_mass(settings: InstrumentSettings, lines: list[str]) -> tuple[CheckedValue, ...] | None:
    """The stated mass of the pendulum against the standard's, where the standard limits it."""
    standard = INSTRUMENTS[settings.kind]
    if settings.mass_kg is None or standard.mass_kg is None or standard.mass_tolerance_kg is None:
        return None
    limits = Limits(standard.mass_kg, standard.mass_tolerance_kg)
    item = check("mass of the pendulum", Estimate(settings.mass_kg, 0.0), limits, "kg")
    lines.append(item.text)
    return (CheckedValue.of(item),)
