"""Results of a pendulum that swings by degrees: turning points, values of its kind, checks by a standard."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, TypeVar

import numpy as np

from processing.ambient import AmbientConditions
from processing.arrays import Floats
from processing.contact import measured_losses
from processing.decay_summary import mean_period
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import points_in_true_time
from processing.instruments import (
    DEGREE_RAD,
    INSTRUMENTS,
    Check,
    Description,
    FrictionLaw,
    Limits,
    SharedError,
    ValueWithSharedErrors,
    check,
    circular_error,
    damping,
    fit_friction_law,
    herbert_hardness,
    inferred_half_cycles,
    joined_half_cycles,
    refined_turning_points,
    rolling_friction,
    with_drive,
    with_release,
    with_shared,
)
from processing.swing import HalfCycle, HalfCycleFlag, TurningPoints, turning_points
from processing.units import seconds
from rig.analysis.decay_values import INSTRUMENT, InstrumentResults
from rig.analysis.result_rows import ResultRow, plain_row
from rig.analysis.turning_plane import FollowedPlane
from rig.settings import InstrumentSettings
from rig.terminal import with_uncertainty

_Values = TypeVar("_Values", bound=NamedTuple)


class Reduction:
    """Results of one run of such a pendulum, collected while it is evaluated."""

    def __init__(self, settings: InstrumentSettings, run: str, half_cycles: Sequence[HalfCycle]) -> None:
        self.settings, self.half_cycles, self._run = settings, half_cycles, run
        self.description: Description = settings.description()
        """Description of this kind of pendulum."""
        self.points = turning_points(half_cycles)
        self.errors: Sequence[SharedError] = ()
        """Errors that the points share."""
        self.lines = [f"{self.description.kind}: {self.description.sentence}"]
        """Text on what no row says."""
        self.rows: list[ResultRow] = []
        self.curves: dict[str, dict[str, Floats]] = {}
        self.checks: list[Check] = []
        self.problem = ""
        """The reason why quantities are missing; empty if none is."""
        self.readings: Mapping[str, ValueWithSharedErrors] = {}
        """Values that a series compares; empty if there are none."""

    def evaluate(
        self, reduce: Callable[[TurningPoints], _Values]
    ) -> tuple[_Values, Mapping[str, ValueWithSharedErrors]]:
        """Values of the points with uncertainties by ground, scale and clock, and their readings."""
        return with_shared(reduce, self.points, self.errors, with_drive(reduce, self.points))

    def add(self, part: str = "", **numbers: Estimate | float | None) -> None:
        """Add a row for each number that is not None, for a named part of the decay or all of it."""
        fit = f"{INSTRUMENT}, {part}" if part else INSTRUMENT
        self.rows += [
            plain_row(key, value if isinstance(value, Estimate) else float(value), self._run, fit)
            for key, value in numbers.items()
            if value is not None
        ]

    def check(self, name: str, value: float, limits: Limits, unit: str) -> None:
        """Compare a value with the limits of the standard."""
        self.checks.append(check(name, Estimate(value, 0.0), limits, unit))

    @property
    def values(self) -> InstrumentResults:
        """The part of results.json other than the rows."""
        return InstrumentResults(
            kind=self.description.kind, curves=self.curves, checks=tuple(self.checks), text=tuple(self.lines)
        )


def _damping(report: Reduction) -> None:
    """Add damping time and number of swings, which are also the readings of a series."""
    description = report.description
    if description.report == "decay":
        decrement, moment, exponent, law = with_drive(_friction, report.points)
        _friction_law(replace(law, moment=moment, exponent=exponent), decrement, report)
    values, report.readings = report.evaluate(
        lambda points: damping(points, description.start_amplitude_rad, description.end_amplitude_rad)
    )
    start_deg, end_deg = values.start_rad / DEGREE_RAD, values.end_rad / DEGREE_RAD
    report.add(
        f"{start_deg:g}° to {end_deg:g}°",
        damping_time_s=values.time_s,
        damping_swings=values.swings,
        missing_half_cycles=values.missing,
        damping_start_deg=start_deg,
        damping_end_deg=end_deg,
    )


def _hardness(report: Reduction) -> None:
    divisions = report.settings.scale_divisions
    hardness, _ = report.evaluate(lambda points: herbert_hardness(points, divisions))
    if hardness.ten_swings_s is None:
        report.lines.append(hardness.missing)
    report.add(
        time_hardness_s=hardness.ten_swings_s,
        scale_hardness=hardness.scale_hardness,
        time_hardness_first_swing_s=hardness.first_swing_times_ten_s,
        first_amplitude_deg=hardness.first_amplitude_rad / DEGREE_RAD,
    )


def _circular(report: Reduction) -> None:
    law, _ = report.evaluate(circular_error)
    report.lines.append(law.sentence)
    report.add(period0_s=law.period0_s, circular_factor=law.factor, chi2_per_dof=law.chi2_per_dof)
    report.curves["period"] = {
        "amplitude_deg": law.amplitude_rad / DEGREE_RAD,
        "period_s": law.period_s,
        "u_period_s": law.u_period_s,
        "circular_law_s": law.ideal_s,
        "alpha_squared_over_16_s": law.sixteenth_s,
    }


def _rolling(report: Reduction) -> None:
    description, settings = report.description, report.settings
    lever = description.lever_m and Estimate(description.lever_m, settings.u_lever_m)
    support = description.support_radius_m
    radius = support and Estimate(support, settings.u_support_radius_m)
    friction, _ = report.evaluate(lambda points: rolling_friction(points, lever or None, radius or None))
    if friction.coefficient is None:
        missing = "no rolling-friction coefficient: state instrument.lever_m and instrument.support_radius_m"
        report.lines.append(missing)
    report.lines += friction.sentences
    _friction_law(friction.law, friction.decrement, report, rolling_friction_coefficient=friction.coefficient)


class _Friction(NamedTuple):
    decrement: Estimate
    moment: Estimate
    exponent: Estimate
    law: FrictionLaw


def _friction(points: TurningPoints) -> _Friction:
    law = fit_friction_law(points)
    return _Friction(law.decrement(law.reference_rad), law.moment, law.exponent, law)


def _friction_law(
    law: FrictionLaw, decrement: Estimate, report: Reduction, **others: Estimate | None
) -> None:
    """Add decrement (and `others`) at the reference amplitude and against amplitude, moment and power."""
    amplitude = f"at {law.reference_rad / DEGREE_RAD:.3g}°"
    report.add(amplitude, **others, log_decrement=decrement, friction_moment=law.moment)
    report.add(friction_exponent=law.exponent, chi2_per_dof=law.chi2_per_dof)
    index = report.points.index
    losses = measured_losses(report.points, cycles=max(1, int(index[-1] - index[0]) // 40))
    report.curves["decrement"] = {
        "amplitude_deg": losses.amplitude_rad / DEGREE_RAD,
        "log_decrement": losses.log_decrement,
        "u_log_decrement": losses.u_log_decrement,
    }


_REPORTERS: Final = {"hardness": _hardness, "circular": _circular, "rolling": _rolling}
"""Functions that add the rows of a kind of report; `_damping` does for all other kinds."""
_MAX_NEGLIGIBLE_ERROR_U: Final = 0.01
"""Error of an amplitude, in its uncertainties, below which it changes no reported value."""


def reduce_run(
    settings: InstrumentSettings,
    followed: FollowedPlane,
    air: AmbientConditions,
    errors: Sequence[SharedError] = (),
    clock_rate: float = 1.0,
    run: str = "",
) -> Reduction:
    """Results of the half-cycles of one run of a pendulum that swings by degrees; its rows name the `run`.

    Half-cycles of the detector and their deflections, in rad, are in the plane of swing; turning points are
    fitted again to deflections by a waveform that holds at degrees. All points share `errors`, perhaps with
    other runs. `clock_rate` is true seconds per second of the deflections' clock.
    """
    report = Reduction(settings, run, followed.half_cycles)
    description, half_cycles = report.description, report.half_cycles
    problems = [followed.problem] if followed.problem else []
    if description.turning_plane or followed.is_turned:
        _swing_plane(followed, report)
    deflections = joined(followed.deflections, DeflectionUnit.RAD)
    if len(deflections):
        if len(half_cycles) > 1:
            half_cycles = refined_turning_points(
                deflections.times_ns, deflections.y, deflections.u_y, half_cycles
            )
        half_cycles = _with_inferred(report, half_cycles, deflections)
        if description.report == "hardness":
            half_cycles = _with_release(report, half_cycles, deflections)
    report.half_cycles, report.points = half_cycles, points_in_true_time(half_cycles, clock_rate)
    report.errors = [*errors, *_plane_errors(followed, report.points)]
    try:
        if followed.problem:
            raise DataError(followed.problem)
        _REPORTERS.get(description.report, _damping)(report)
    except DataError as error:
        problems.append(str(error))
        if len(report.points) > 1:
            report.add(mean_period_s=mean_period(report.points))
    _check_conditions(report, air)
    report.problem = "; ".join(dict.fromkeys(problems))
    return report


def _swing_plane(followed: FollowedPlane, report: Reduction) -> None:
    plane = followed.plane
    if plane is None:
        report.lines.append("the plane of swing is not known: too few periods were seen along both axes")
        return
    duration_s = seconds(followed.half_cycles[-1].turn_time_ns - plane.start_ns)
    rate_deg_per_min, rotation_deg = (
        Estimate(span_s / DEGREE_RAD * plane.mean_rate(), span_s / DEGREE_RAD * plane.u_mean_rate())
        for span_s in (60.0, duration_s)
    )
    angles = np.unwrap([balance.line_angle_rad for balance in followed.balances], period=math.pi)
    times_ns = np.array([balance.time_ns for balance in followed.balances])
    report.curves["plane"] = {
        "direction_deg": angles / DEGREE_RAD,
        "time_s": seconds(times_ns - plane.start_ns),
    }
    report.add(
        plane_rate_deg_per_min=rate_deg_per_min,
        plane_turned_deg=rotation_deg,
        plane_width_ratio=max(balance.width_ratio for balance in followed.balances),
    )


def _plane_errors(followed: FollowedPlane, points: TurningPoints) -> list[SharedError]:
    """Errors by the uncertain plane of swing, which no other run shares."""
    errors = followed.amplitude_errors(points)
    if errors is None:
        return []
    matters = np.max(np.abs(errors) / points.u_amplitude[:, None], axis=0) > _MAX_NEGLIGIBLE_ERROR_U
    return [SharedError("", amplitude_rad=error) for error in errors.T[matters]]


def _with_inferred(
    report: Reduction, half_cycles: Sequence[HalfCycle], deflections: Deflections
) -> Sequence[HalfCycle]:
    """Half-cycles with those whose turning point lay off the sensor, which a row counts."""
    inferred = inferred_half_cycles(deflections.times_ns, deflections.y, deflections.u_y)
    if not inferred:
        return half_cycles
    half_cycles = joined_half_cycles(half_cycles, inferred)
    count = sum(bool(h.flags & HalfCycleFlag.INFERRED) for h in half_cycles)
    report.add(inferred_half_cycles=count)
    return [replace(h, flags=h.flags & ~int(HalfCycleFlag.INFERRED)) for h in half_cycles]


def _with_release(
    report: Reduction, half_cycles: Sequence[HalfCycle], deflections: Deflections
) -> Sequence[HalfCycle]:
    """Half-cycles with the release as the first turning point, where it was recorded; a line says which."""
    released = with_release(deflections.times_ns, deflections.y, deflections.u_y, half_cycles)
    if released is not None:
        # its time alone says nothing, since deflections may begin at any time before it
        release, turn = released[:2]
        delay_s = float(seconds(turn.turn_time_ns - release.turn_time_ns))
        delay = with_uncertainty(delay_s, math.hypot(release.u_turn_time_s, turn.u_turn_time_s))
        angle = with_uncertainty(release.amplitude / DEGREE_RAD, release.u_amplitude / DEGREE_RAD)
        report.lines.append(f"released at {angle} degrees, {delay} s before the next turning point")
        return released
    if any(h.flags & HalfCycleFlag.START for h in half_cycles):
        report.lines.append(
            "the release itself is disturbed or was not recorded: the first swing is that from the first "
            "turning point seen"
        )
    return half_cycles


def _check_conditions(report: Reduction, air: AmbientConditions) -> None:
    """Check air and stated mass of the pendulum against the standard, where it limits them."""
    description, settings = report.description, report.settings
    for name, value, limits, unit in (
        ("temperature", air.temperature_c, description.temperature_c, "°C"),
        ("humidity", air.humidity_percent, description.humidity_percent, "%"),
    ):
        if limits is not None and math.isnan(value):
            wanted = f"{limits.value:g} ± {limits.tolerance:g} {unit}"
            report.lines.append(f"{name} is not known; the standard wants {wanted}")
        elif limits is not None:
            report.check(name, value, limits, unit)
    standard = INSTRUMENTS[settings.kind]
    if not (settings.mass_kg is None or standard.mass_kg is None or standard.mass_tolerance_kg is None):
        limits = Limits(standard.mass_kg, standard.mass_tolerance_kg)
        report.check("mass of the pendulum", settings.mass_kg, limits, "kg")
