"""What each kind of pendulum reports of its turning points: values for results.json and lines of text."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

from processing.contact import measured_losses
from processing.estimate import Estimate
from processing.instruments import (
    DEGREE_RAD,
    Description,
    FrictionLaw,
    Reading,
    SharedError,
    circular_error,
    damping,
    fit_friction_law,
    herbert_hardness,
    rolling_friction,
    with_drive,
    with_shared,
)
from processing.periods import mean_period
from processing.swing import TurningPoints
from rig.analysis.instrument_results import (
    DampingResults,
    DecrementTable,
    FrictionLawResults,
    InstrumentResults,
    PeriodTable,
)
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings

Found = TypeVar("Found", bound=NamedTuple)


def report_of_kind(
    description: Description,
    settings: InstrumentSettings,
    points: TurningPoints,
    values: InstrumentResults,
    lines: list[str],
    errors: Sequence[SharedError],
) -> tuple[InstrumentResults, Mapping[str, Reading]]:
    """The values with what this kind reports, and what a series takes of them; lines are added.

    `errors` are those that runs may share. Raises DataError where a report cannot be had.
    """
    if description.report == "hardness":
        return _hardness(settings, points, values, lines, errors), {}
    if description.report == "circular":
        return _circular(points, values, lines, errors), {}
    if description.report == "rolling":
        return _rolling(description, settings, points, values, lines, errors), {}
    if description.report == "decay":
        values = _decrements(points, values, lines)
    found, readings = _evaluated(
        lambda at: damping(at, description.start_amplitude_rad, description.end_amplitude_rad),
        points,
        errors,
    )
    start_deg, end_deg = found.start_rad / DEGREE_RAD, found.end_rad / DEGREE_RAD
    lines.append(
        f"from {start_deg:g} to {end_deg:g} degrees: damping time "
        f"{with_uncertainty(*found.time_s)} s, {with_uncertainty(*found.swings)} swings"
    )
    reported = DampingResults(start_deg, end_deg, found.time_s, found.swings, found.missing)
    return replace(values, damping=reported), readings


def _evaluated(
    reduce: Callable[[TurningPoints], Found], points: TurningPoints, errors: Sequence[SharedError]
) -> tuple[Found, Mapping[str, Reading]]:
    """With what the ground, the scale and the clock add to every uncertainty."""
    return with_shared(reduce, points, errors, with_drive(reduce, points))


def _hardness(
    settings: InstrumentSettings,
    points: TurningPoints,
    values: InstrumentResults,
    lines: list[str],
    errors: Sequence[SharedError],
) -> InstrumentResults:
    hardness, _ = _evaluated(lambda at: herbert_hardness(at, settings.scale_divisions), points, errors)
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
    points: TurningPoints, values: InstrumentResults, lines: list[str], errors: Sequence[SharedError]
) -> InstrumentResults:
    law, _ = _evaluated(circular_error, points, errors)
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
    errors: Sequence[SharedError],
) -> InstrumentResults:
    lever = description.lever_m and Estimate(description.lever_m, settings.u_lever_m)
    radius = description.support_radius_m and Estimate(
        description.support_radius_m, settings.u_support_radius_m
    )
    found, _ = _evaluated(lambda at: rolling_friction(at, lever or None, radius or None), points, errors)
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


class _Friction(NamedTuple):
    decrement: Estimate
    moment: Estimate
    exponent: Estimate
    law: FrictionLaw


def _friction(points: TurningPoints) -> _Friction:
    law = fit_friction_law(points)
    return _Friction(law.decrement(law.reference_rad), law.moment, law.exponent, law)


def _decrements(points: TurningPoints, values: InstrumentResults, lines: list[str]) -> InstrumentResults:
    decrement, moment, exponent, law = with_drive(_friction, points)
    law = replace(law, moment=moment, exponent=exponent)
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


def range_and_period(points: TurningPoints, values: InstrumentResults, lines: list[str]) -> InstrumentResults:
    """Range and period, which may be had where the quantity asked for cannot."""
    if len(points) < 2:
        return values
    first, last = (float(points.amplitude[at]) / DEGREE_RAD for at in (0, -1))
    lines.append(
        f"what there is: {len(points)} half-cycles from {first:.4g} to {last:.4g} degrees, "
        f"mean period {mean_period(points):.6g} s"
    )
    return replace(values, amplitude_deg=(first, last), mean_period_s=mean_period(points))
