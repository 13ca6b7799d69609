"""What is reported of a kind of pendulum: plain values for results.json, lines for the terminal."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from processing.contact import measured_losses
from processing.deflections import Deflections
from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments import (
    DEGREE_RAD,
    INSTRUMENTS,
    Check,
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
from rig.analysis.contact_tree import estimate_tree
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

    `problem` is the one line that says what could not be had; `values` holds what could.
    """

    settings: InstrumentSettings
    values: Mapping[str, Any]
    lines: Sequence[str]
    points: TurningPoints
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
    values: dict[str, Any] = {"kind": description.kind}
    lines = [f"{description.kind}: {description.sentence}"]
    problems: list[str] = []
    if deflections is not None and len(swings) > 1:
        if description.turning_plane:
            try:
                swings, deflections = _in_its_plane(swings, deflections, values, lines)
            except DataError as error:
                problems.append(str(error))
        swings = refined(deflections.times_ns, deflections.y, deflections.u_y, swings)
    if deflections is not None:
        swings = _with_inferred(swings, deflections, values, lines)
    points = turning_points(swings)
    found: Damping | None = None
    try:
        found = _reduce(description, settings, points, values, lines, u_scale_relative)
    except DataError as error:
        problems.append(str(error))
        _what_is_left(points, values, lines)
    _held_against_air(description, air, values, lines)
    _check_mass(settings, values, lines)
    values["text"] = list(lines)
    return Reduction(settings, values, lines, points, "; ".join(problems), found, air)


def _with_inferred(
    swings: Sequence[Swing], deflections: Deflections, values: dict[str, Any], lines: list[str]
) -> Sequence[Swing]:
    """Half-cycles whose turning point lay off the sensor are added, counted and said."""
    off = inferred_swings(deflections.times_ns, deflections.y, deflections.u_y)
    if not off:
        return swings
    joined = joined_swings(swings, off)
    kept = sum(bool(swing.flags & SwingFlag.INFERRED) for swing in joined)
    values["inferred_half_cycles"] = kept
    lines.append(
        f"{kept} of {len(joined)} turning points lay off the sensor, inferred from the crossings' speeds"
    )
    return [replace(swing, flags=swing.flags & ~int(SwingFlag.INFERRED)) for swing in joined]


def _reduce(
    description: Description,
    settings: InstrumentSettings,
    points: TurningPoints,
    values: dict[str, Any],
    lines: list[str],
    u_scale: float,
) -> Damping | None:
    if description.report == "hardness":
        hardness = with_scale(lambda at: herbert_hardness(at, settings.scale_divisions), points, u_scale)
        values["first_amplitude_deg"] = hardness.first_amplitude_rad / DEGREE_RAD
        values["time_hardness_first_swing_s"] = estimate_tree(*hardness.first_swing_times_ten_s)
        values["scale_hardness"] = estimate_tree(*hardness.scale_hardness)
        if hardness.ten_swings_s is not None:
            values["time_hardness_s"] = estimate_tree(*hardness.ten_swings_s)
            lines.append(f"time hardness (ten single swings) {with_uncertainty(*hardness.ten_swings_s)} s")
        else:
            values["problem"] = hardness.missing
            lines.append(hardness.missing)
        lines.append(
            f"time hardness (first swing x 10) {with_uncertainty(*hardness.first_swing_times_ten_s)} s, "
            f"scale hardness {with_uncertainty(*hardness.scale_hardness)} of {settings.scale_divisions:g}"
        )
        return None
    if description.report == "circular":
        law = with_scale(circular_error, points, u_scale)
        values["period0_s"] = estimate_tree(*law.period0_s)
        values["circular_factor"] = estimate_tree(*law.factor)
        values["chi2_per_dof"] = law.chi2_per_dof
        values["table"] = {
            "amplitude_deg": (law.amplitude_rad / DEGREE_RAD).tolist(),
            "period_s": law.period_s.tolist(),
            "u_period_s": law.u_period_s.tolist(),
            "circular_law_s": law.law_s.tolist(),
            "alpha_squared_over_16_s": law.sixteenth_s.tolist(),
        }
        lines += [f"period at vanishing amplitude {with_uncertainty(*law.period0_s)} s", law.sentence]
        return None
    if description.report == "rolling":
        _roll(description, settings, points, values, lines, u_scale)
        return None
    if description.report == "decay":
        _decrements(points, values, lines)
    found = with_scale(
        lambda at: damping(at, description.start_amplitude_rad, description.end_amplitude_rad),
        points,
        u_scale,
    )
    values["damping"] = {
        "start_amplitude_deg": found.start_rad / DEGREE_RAD,
        "end_amplitude_deg": found.end_rad / DEGREE_RAD,
        "time_s": estimate_tree(*found.time_s),
        "swings": estimate_tree(*found.swings),
        "missing_half_cycles": found.missing,
    }
    lines.append(
        f"from {found.start_rad / DEGREE_RAD:g} to {found.end_rad / DEGREE_RAD:g} degrees: damping time "
        f"{with_uncertainty(*found.time_s)} s, {with_uncertainty(*found.swings)} swings"
    )
    return found


def _roll(
    description: Description,
    settings: InstrumentSettings,
    points: TurningPoints,
    values: dict[str, Any],
    lines: list[str],
    u_scale: float,
) -> None:
    lever = description.lever_m and Estimate(description.lever_m, settings.u_lever_m)
    radius = description.support_radius_m and Estimate(
        description.support_radius_m, settings.u_support_radius_m
    )
    found = with_scale(lambda at: rolling_friction(at, lever or None, radius or None), points, u_scale)
    _law(found.law, values)
    values["log_decrement"] = estimate_tree(*found.decrement)
    values["constant_decrement"] = found.constant_decrement
    values["independent_of_speed"] = found.independent_of_speed
    at = found.law.reference_rad / DEGREE_RAD
    lines.append(f"log decrement at {at:.4g} degrees {with_uncertainty(*found.decrement)}")
    if found.coefficient is not None:
        values["rolling_friction_coefficient"] = estimate_tree(*found.coefficient)
        lines.append(
            f"rolling-friction coefficient at {at:.4g} degrees {with_uncertainty(*found.coefficient)}"
        )
    else:
        values["problem"] = (
            "no rolling-friction coefficient: state instrument.lever_m and instrument.support_radius_m"
        )
        lines.append(values["problem"])
    lines += found.sentences
    _losses(points, values)


def _decrements(points: TurningPoints, values: dict[str, Any], lines: list[str]) -> None:
    law = fit_friction_law(points)
    _law(law, values)
    decrement = law.decrement(law.reference_rad)
    values["log_decrement"] = estimate_tree(*decrement)
    lines.append(
        f"log decrement at {law.reference_rad / DEGREE_RAD:.4g} degrees {with_uncertainty(*decrement)}, "
        f"friction goes as amplitude^({with_uncertainty(*law.exponent)})"
    )
    _losses(points, values)


def _law(law: FrictionLaw, values: dict[str, Any]) -> None:
    values["friction_law"] = {
        "reference_amplitude_deg": law.reference_rad / DEGREE_RAD,
        "moment": estimate_tree(*law.moment),
        "exponent": estimate_tree(*law.exponent),
        "chi2_per_dof": law.chi2_per_dof,
    }


def _losses(points: TurningPoints, values: dict[str, Any]) -> None:
    cycles = max(1, int(points.index[-1] - points.index[0]) // 40)
    losses = measured_losses(points, cycles=cycles)
    values["decrement_against_amplitude"] = {
        "amplitude_deg": (losses.amplitude_rad / DEGREE_RAD).tolist(),
        "log_decrement": losses.log_decrement.tolist(),
        "u_log_decrement": losses.u_log_decrement.tolist(),
    }


def _what_is_left(points: TurningPoints, values: dict[str, Any], lines: list[str]) -> None:
    """Where the quantity asked for cannot be had: range and period, which may be."""
    if len(points) < 2:
        return
    first, last = points.amplitude[0] / DEGREE_RAD, points.amplitude[-1] / DEGREE_RAD
    values["amplitude_deg"] = [float(first), float(last)]
    values["mean_period_s"] = mean_period(points)
    lines.append(
        f"what there is: {len(points)} half-cycles from {first:.4g} to {last:.4g} degrees, "
        f"mean period {mean_period(points):.6g} s"
    )


def _in_its_plane(
    swings: Sequence[Swing], deflections: Deflections, values: dict[str, Any], lines: list[str]
) -> tuple[Sequence[Swing], Deflections]:
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
    values["swing_plane"] = {
        "direction_deg": (plane.direction_rad / DEGREE_RAD).tolist(),
        "time_s": plane.time_s.tolist(),
        "rate_deg_per_min": estimate_tree(*per_minute),
        "turned_deg": estimate_tree(*(value / DEGREE_RAD for value in plane.turned_rad)),
        "width_ratio": plane.width_ratio,
    }
    lines.append(
        f"the swing plane turns by {with_uncertainty(*per_minute)} degrees/min, "
        f"{plane.turned_rad.value / DEGREE_RAD:.3g} degrees in all"
    )
    return found, replace(deflections, y=y, u_y=u_y)


def _held_against_air(description: Description, air: Air, values: dict[str, Any], lines: list[str]) -> None:
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
        found.append(check_tree(item))
        lines.append(item.text)
    if found:
        values["environment"] = found


def _check_mass(settings: InstrumentSettings, values: dict[str, Any], lines: list[str]) -> None:
    """The stated mass of the pendulum against the standard's, where the standard limits it."""
    standard = INSTRUMENTS[settings.kind]
    if settings.mass_kg is None or standard.mass_kg is None or standard.mass_tolerance_kg is None:
        return
    limits = Limits(standard.mass_kg, standard.mass_tolerance_kg)
    item = check("mass of the pendulum", Estimate(settings.mass_kg, 0.0), limits, "kg")
    values["apparatus"] = [check_tree(item)]
    lines.append(item.text)


def check_tree(item: Check) -> dict[str, Any]:
    """One check as plain values."""
    return {
        "name": item.name,
        **estimate_tree(*item.measured),
        "lowest": item.lowest,
        "highest": item.highest,
        "unit": item.unit,
        "verdict": item.verdict,
        "text": item.text,
    }
