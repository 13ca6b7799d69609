"""From half-cycles to the results of a run: its fits and verdicts, or the values of another pendulum."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition.record import pixels_path
from acquisition.record.digest import cached_sha256
from calibration import Axes
from processing.ambient import AmbientConditions
from processing.decay_summary import MIN_TURNING_POINTS, mean_period
from processing.deflections import DeflectionUnit
from processing.errors import DataError, RecordError
from processing.fit import FitResult, InputQuantity, points_in_true_time, row_delay
from processing.instruments import SharedError
from processing.swing import TurningPoints
from rig.analysis.ambient import FREE_DRAG, assumed_drifts, drag_of_fit, evidence_of
from rig.analysis.contact_fits import fit_decay, refined_half_cycles
from rig.analysis.contact_verdicts import rig_quantities, with_contact
from rig.analysis.other_instruments import reduce_run
from rig.analysis.run_values import PositionErrors, StoredTurningPoints
from rig.analysis.series import AnalysedRun
from rig.analysis.turning_plane import FollowedPlane
from rig.instrument import pendulum_on_ball
from rig.intake import SeismometerRecord
from rig.settings import Configuration

_MAX_FAST_RATIO: Final = 3.0
"""Fast over slow motion above which the pendulum hardly swung along the stated slow mode."""
_MAX_SHOWN_RATIO: Final = 100.0
"""Largest ratio that is shown as a number."""


def analyse_swings(
    path: Path,
    followed: FollowedPlane,
    config: Configuration,
    air: AmbientConditions,
    u_clock: float = 0.0,
    seismometer: SeismometerRecord | None = None,
    *,
    u_common_rad: float = 0.0,
) -> AnalysedRun:
    """Results of one run, or of one decay of a table, for its kind of pendulum; without rows of the decay.

    `followed` are the half-cycles of the file at `path`, and their deflections, in their plane of swing.
    `u_clock` is the relative standard uncertainty of the second of their times, `u_common_rad` that of an
    error that all amplitudes share, `seismometer` the record of an auxiliary one.
    """
    deflections, unit = followed.deflections, followed.deflections.unit
    if config.instrument.description().report != "contact" and unit is DeflectionUnit.RAD:
        return _reduce_run(path, followed, config, air, _shared_errors(config, u_clock, u_common_rad))
    pendulum, clock_rate = pendulum_on_ball(config), clock_rate_of(config)
    drag, air_drag = FREE_DRAG, None
    detected = points_in_true_time(followed.half_cycles, clock_rate)
    if pendulum is not None and len(detected) > 1:
        drag, air_drag = drag_of_fit(config, air, pendulum, mean_period(detected))
    drifts = assumed_drifts(config, air)
    refined = refined_half_cycles(
        followed.half_cycles, deflections, unit, pendulum, config.fit, clock_rate, drag
    )
    points = points_in_true_time(refined.half_cycles, clock_rate)
    unflagged = [h for h in refined.half_cycles if not h.flags]
    fits: Mapping[str, FitResult] = {}
    use, problem, seismogram = None, followed.problem, None
    if not problem and unit is not DeflectionUnit.RAD:
        problem = "the record has no calibration (no [lever]): amplitudes are in px, the laws need rad"
    if seismometer is not None and unflagged:
        seismogram = seismometer.seismogram(unflagged[0].turn_time_ns)
    try:
        if not problem:
            fits, points, use = fit_decay(
                points,
                pendulum,
                config.fit,
                refined.exact,
                drag=drag.fitted,
                evidence=evidence_of(drag, refined.harmonics),
                drifts={name: drift.u for name, drift in drifts.items()} if config.fit.drifts else None,
                seismometer=seismogram,
            )
    except DataError as error:
        problem = str(error)
    ratio = deflections.fast_ratio()
    errors = None if refined.position_map is None else PositionErrors.of(refined.position_map, unit)
    warnings = list(dict.fromkeys([*_fit_warnings(fits), *filter(None, [refined.doubt])]))
    if refined.harmonics is not None and config.lever is not None and len(points) > 1:
        delay = row_delay(refined.harmonics, mean_period(points))
        if delay.seen:
            warnings.append(delay.text(config.lever.pixel_pitch_m / (2.0 * config.lever.arm_m)))
    rest_rad = float(np.median([h.centre for h in unflagged] or [0.0]))
    inputs = {
        "common_amplitude_rad": InputQuantity(0.0, u_common_rad),
        "plane_of_swing_rad": InputQuantity(0.0, followed.u_rad),
        **({} if config.fit.drifts else drifts),
    }
    if use is not None and seismometer is not None:
        use = replace(use, source=seismometer.name, understood=seismometer.understood)
    run = AnalysedRun(
        **_file_fields(path, points, unit),
        measured_again_on=refined.motion,
        position_errors=errors,
        problem=why_no_half_cycles(path.name, ratio, len(points), config.axes) or problem,
        warnings=tuple(warnings),
        settings=config.fit.model_dump(),
        turning_points=StoredTurningPoints.of(points, refined.half_cycles, unit, clock_rate),
        seismometer=use,
        notes=tuple(filter(None, [followed.text, "" if errors is None else errors.text])),
        fitted=fits,
        rig=rig_quantities(config, ratio, rest_rad, u_clock, **inputs),
    )
    if not fits or pendulum is None:
        return run
    return with_contact(run, pendulum, followed.amplitude_errors(points), air_drag)


def _reduce_run(
    path: Path,
    followed: FollowedPlane,
    config: Configuration,
    air: AmbientConditions,
    errors: Sequence[SharedError],
) -> AnalysedRun:
    """Results of a run of a pendulum that the contact's laws do not describe."""
    clock_rate, unit = clock_rate_of(config), DeflectionUnit.RAD
    reduction = reduce_run(config.instrument, followed, air, errors, clock_rate, path.stem)
    return AnalysedRun(
        **_file_fields(path, reduction.points, unit),
        table=tuple(reduction.rows),
        problem=reduction.problem,
        settings=config.instrument.model_dump(mode="json"),
        instrument=reduction.values,
        turning_points=StoredTurningPoints.of(reduction.points, reduction.half_cycles, unit, clock_rate),
        reduction=reduction,
    )


def _shared_errors(config: Configuration, u_clock: float, u_common_rad: float) -> list[SharedError]:
    """Errors of scale and clock that all turning points of a run share, and, by equal names, several runs."""
    errors = [SharedError("compression", amplitude_rad=u_common_rad)]
    if (lever := config.lever) is not None:
        u_pitch = lever.u_pixel_pitch_m / lever.pixel_pitch_m
        errors += [
            SharedError(f"arm {lever.arm_m!r} {lever.u_arm_m!r}", scale=lever.u_arm_m / lever.arm_m),
            # named by its relative value, so that binned pixels of one sensor share it, too
            SharedError(f"pixel pitch {u_pitch:.6g}", scale=u_pitch),
        ]
    errors.append(SharedError(f"clock {clock_rate_of(config)!r}", clock=u_second(config, u_clock)))
    return [error for error in errors if error.scale or error.clock or np.any(error.amplitude_rad)]


def _file_fields(path: Path, points: TurningPoints, unit: DeflectionUnit) -> dict[str, Any]:
    """Fields of a run's results that name its file, the unit and the number of half-cycles."""
    pixels = pixels_path(path)
    return dict[str, Any](
        path=path,
        record=path.name,
        sha256=_sha256_if_readable(path),
        inputs_sha256={pixels.name: _sha256_if_readable(pixels)} if pixels.is_file() else {},
        half_cycles=len(points),
        amplitude_unit=unit.shown,
    )


def _sha256_if_readable(path: Path) -> str:
    """Hash by which results find their record; empty where its disk cannot read all of it."""
    try:
        return cached_sha256(path)
    except RecordError:
        return ""


def clock_rate_of(config: Configuration) -> float:
    """True seconds per second of the camera's clock, by its calibration; 1 without one."""
    return config.timebase.camera_rate if config.timebase is not None else 1.0


def u_second(config: Configuration, u_clock: float) -> float:
    """Relative standard uncertainty of a second: the larger of the calibration's and the run's own."""
    return u_clock if config.timebase is None else max(config.timebase.u_camera_rate, u_clock)


def _fit_warnings(fits: Mapping[str, FitResult]) -> list[str]:
    """Warnings of the fits: those of every fit once, others with the name of their fit."""
    names_by_warning: dict[str, list[str]] = {}
    for name, fit in fits.items():
        for warning in fit.warnings:
            names_by_warning.setdefault(warning, []).append(name)
    return [
        warning if len(names) == len(fits) else f"{names[0]} fit: {warning}"
        for warning, names in names_by_warning.items()
    ]


def why_no_half_cycles(record: str, fast_over_slow: float, half_cycles: int, axes: Axes | None) -> str:
    """Problem of a motion across the slow mode, which gives hardly any half-cycles, with its remedy.

    The text is empty where there are enough half-cycles, or the motion is not across. Half-cycles are those
    along the slow mode, which is the sensor's y unless `axes` state another direction.
    """
    if half_cycles >= MIN_TURNING_POINTS or not fast_over_slow > _MAX_FAST_RATIO:
        return ""
    stated_rad = 0.0 if axes is None else axes.slow_angle_rad
    # both directions across would do; this one is within the limits of the key
    across_rad = stated_rad + math.copysign(0.5 * math.pi, -stated_rad or 1.0)
    shown = min(fast_over_slow, _MAX_SHOWN_RATIO)
    factor = f"{shown:.2g}" if shown < _MAX_SHOWN_RATIO else f"more than {shown:g}"
    fast, slow = ("x", "y") if axes is None else ("the fast axis of [axes]", "the slow one")
    return (
        f"the swing is along {fast}, {factor} times as far as along {slow}, where half-cycles "
        f"are sought: state [axes] slow_angle_rad = {across_rad:.5g}; rig replay {record} --set "
        f"axes.slow_angle_rad={across_rad:.5g} finds them in the record"
    )
