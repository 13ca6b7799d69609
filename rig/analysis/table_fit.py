"""Analysis of a table by `rig fit`: every decay in it as a run of the rig."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.record.digest import cached_sha256
from processing.contact import StatedLaw
from processing.contact.laws import Law
from processing.decay_summary import summarise_decay
from processing.deflections import Deflections, DeflectionUnit, joined, slow_deflections
from processing.errors import DataError
from processing.swing import (
    HalfCycle,
    HalfCycleFlag,
    SampleScatter,
    estimate_noise,
    estimate_scatter,
    swings_of,
    swings_of_blocks,
    turning_points,
)
from processing.units import ARCSEC_RAD, seconds
from rig.analysis.ambient import ambient_warnings, stated_ambient, table_ambient
from rig.analysis.compared_laws import with_laws
from rig.analysis.decay_values import decay_rows, decay_values
from rig.analysis.half_cycle_fits import analyse_swings
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.results import SessionResults
from rig.analysis.results_file import relative_record
from rig.analysis.run_values import StoredTurningPoints, TableDecay, TableUnit
from rig.analysis.series import AnalysedRun, instrument_series
from rig.analysis.turning_plane import FollowedPlane, follow_plane
from rig.intake import (
    FIRST_UTC_S,
    SeismometerRecord,
    Trajectory,
    along_and_across,
    clipping_warnings,
    decay_warnings,
    fast_mode_ratio,
    fast_oscillation,
    judge_sign,
    judge_time_unit,
    missing_for_laws,
    strange_amplitudes,
)
from rig.settings import Configuration

_STATED = ("sample", "operator", "contact_history", "notes")
_MIN_USABLE_HALF_CYCLES = 4  # what the summary of a decay needs (processing/decay_summary.py)
_EDGE_HALF_PERIODS = 0.75
"""Half periods before the first and after the last turning point of a decay whose samples belong to it."""
_MIN_PUSHED_RATIO = 1.2
"""Ratio of neighbouring amplitudes above which the pendulum was pushed again: 20 % of its amplitude are
nearly half of its energy."""
_MIN_PUSHED_U = 6.0
"""Standard uncertainties by which such an amplitude has to be larger: faint amplitudes grow by noise, by so
much once in 10^9 half-cycles."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class AnalysedTable(SessionResults):
    """The results of a table, with what its report needs in addition and no file holds.

    `positions` are those that were read, `noise` that of a sample in their unit, `passed_over` are decays of
    too few usable half-cycles.
    """

    runs: tuple[AnalysedRun, ...]
    positions: Trajectory
    noise: float
    passed_over: Sequence[Sequence[HalfCycle]]

    @property
    def longest(self) -> AnalysedRun:
        """The decay with most half-cycles."""
        return max(self.runs, key=lambda decay: len(turning_points(decay.swings)))


def analyse_trajectory(
    path: Path,
    trajectory: Trajectory,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw] = (),
    seismometer: SeismometerRecord | None = None,
) -> AnalysedTable:
    """Results of positions that were read from a table or a film.

    Its half-cycles are detected, its decays separated, each analysed as a run is. Two positions are first
    turned onto the direction of the larger motion. The contact's law is fitted where unit and pendulum allow,
    with the auxiliary `seismometer` if there is one, and compared with further `laws`. Raises
    DataError with the reason where there is no decay.
    """
    judge_sign(path, trajectory)
    scale = trajectory.scale_rad or 1.0
    deflection, across = (one * scale for one in along_and_across(trajectory.positions))
    scatter = estimate_scatter(trajectory.times_ns, deflection)
    noise = scatter.noise
    swings = swings_of(trajectory.times_ns, deflection, scatter.u_deflection)
    parts = separate_decays(swings)
    usable = [part for part in parts if len(turning_points(part)) >= _MIN_USABLE_HALF_CYCLES]
    if not usable:
        judge_time_unit(path, trajectory)
        most = max((len(turning_points(part)) for part in parts), default=0)
        remedy = trajectory.remedy or (
            f"Time is {trajectory.time_name}, position {' and '.join(trajectory.names)}; --time and "
            "--position choose others"
        )
        raise DataError(
            f"{path}: {most} usable half-cycle{'' if most == 1 else 's'} ({len(swings) - most} more are "
            f"flagged or of other decays), at least {_MIN_USABLE_HALF_CYCLES} are needed: the samples hold "
            "no free decay, too little of one, or a second oscillation as large, which has to be filtered. "
            f"{remedy}"
        )
    judge_time_unit(path, trajectory, usable)
    both = _both_deflections(trajectory.times_ns, across, deflection, scatter)
    runs = tuple(
        _analyse(path, part, trajectory, both, scatter, config, laws, seismometer) for part in usable
    )
    # decays of one run are numbered by the run's number if it has one, else by place
    numbers = [int(trajectory.run)] * len(runs) if trajectory.run.isdecimal() else ()
    return AnalysedTable(
        trajectory=path.as_posix(),
        unit=trajectory.unit,
        understood=trajectory.understood,
        runs=runs,
        series=instrument_series(runs, numbers),
        positions=trajectory,
        noise=noise / scale,
        passed_over=[part for part in parts if part not in usable],
    )


def series_of_runs(path: Path, tables: Mapping[str, AnalysedTable]) -> SessionResults | None:
    """Results of several runs, by name, with their series; None where there is no series.

    The numbers in `reference_runs` are the names of the runs where all are numbers, else their places.
    """
    by_name = all(name.isdecimal() for name in tables)
    numbered = [
        (int(name) if by_name else place, decay)
        for place, (name, table) in enumerate(tables.items(), start=1)
        for decay in table.runs
    ]
    runs = tuple(run for _, run in numbered)
    series = instrument_series(runs, [number for number, _ in numbered])
    if series is None:
        return None
    return replace(next(iter(tables.values())), trajectory=path.as_posix(), runs=runs, series=series)


def _analyse(
    path: Path,
    swings: Sequence[HalfCycle],
    trajectory: Trajectory,
    deflections: Deflections,
    scatter: SampleScatter,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw],
    seismometer: SeismometerRecord | None,
) -> AnalysedRun:
    """Results of one decay, by the same steps as those of a record."""
    u_common = trajectory.u_common_over_noise * scatter.noise
    edge_ns = _EDGE_HALF_PERIODS * 0.5e9 * summarise_decay(turning_points(swings)).period_s.value
    inside = (trajectory.times_ns > swings[0].turn_time_ns - edge_ns) & (
        trajectory.times_ns < swings[-1].turn_time_ns + edge_ns
    )
    passing = PassingDeflections([deflections[inside]], DeflectionUnit.RAD)
    followed = _without_fast_mode(follow_plane(swings, passing, None, along_line=True))
    swings = followed.swings
    deflection = np.concatenate([block.y for block in followed.deflections])
    points = turning_points(swings)
    summary = summarise_decay(points)
    problem = missing_for_laws(trajectory, config)
    sha256 = cached_sha256(path)
    run = AnalysedRun(path=path, record=relative_record(path, Path.cwd()), sha256=sha256, problem=problem)
    if config is not None and not problem:
        zero_ns = trajectory.first_ns
        if seismometer is not None:
            utc_ns = zero_ns if seconds(zero_ns) > FIRST_UTC_S else None
            seismometer = replace(seismometer, to_file_ns=zero_ns, to_utc_ns=utc_ns)
        run = analyse_swings(
            path,
            followed,
            config,
            stated_ambient(config),
            seismometer=seismometer,
            u_common_rad=u_common,
        )
        run = with_laws(run, laws) if laws else run
    unflagged = [swing.turn_time_ns for swing in swings if not swing.flags]
    scale = trajectory.scale_rad or 1.0
    # without the time in which the pendulum is held or pushed
    free = trajectory.times_ns[inside] >= next(swing.turn_time_ns for swing in swings if not swing.flags)
    oscillation = fast_oscillation(
        trajectory.times_ns[inside][free], deflection[free], summary.period_s.value
    )
    decay = decay_values(points, scale, u_common=u_common)
    warnings = [
        *run.warnings,
        *filter(None, ["" if followed.problem == run.problem else followed.problem, oscillation]),
        *decay_warnings(summary),
        *(
            line
            for name, values in zip(trajectory.names, trajectory.positions, strict=True)
            for line in clipping_warnings(name, values[inside])
        ),
    ]
    notes = [followed.text if followed.text not in run.notes and run.instrument is None else ""]
    if scatter.jitter_s > 0:
        notes.append(
            f"the times jitter by {1e3 * scatter.jitter_s:.2g} ms, as stamps of a host do: what that moves "
            "the samples by is in their uncertainties"
        )
    unit = TableUnit.OWN if trajectory.scale_rad is None else DeflectionUnit.RAD
    session: dict[str, str] = {}
    if config is not None:
        began_s = seconds(trajectory.first_ns)
        found = table_ambient(config, began_s if began_s > FIRST_UTC_S else None)
        run = replace(run, ambient=found)
        session = {key: text for key in _STATED if (text := getattr(config.session, key))}
        warnings += ambient_warnings(found)
        warnings += strange_amplitudes(points.amplitude / ARCSEC_RAD, trajectory, config)
        notes += _taken_as_exact(config) if run.budget else []
    return replace(
        run,
        swings=swings,
        table=(*run.table, *decay_rows(points, decay, trajectory.unit, scale, path.stem)),
        frames=int(np.count_nonzero(inside)),
        half_cycles=run.half_cycles or summary.half_cycles,
        amplitude_unit=trajectory.unit,
        damping=decay.damping,
        warnings=tuple(warnings),
        notes=(*run.notes, *filter(None, notes)),
        turning_points=run.turning_points or StoredTurningPoints.of(points, swings, unit, 1.0),
        decay=TableDecay(
            began_s=seconds(unflagged[0]),
            ended_s=seconds(unflagged[-1]),
            run=trajectory.run,
            columns=trajectory.names,
            session=session,
        ),
    )


def _without_fast_mode(followed: FollowedPlane) -> FollowedPlane:
    """The decay without the part of the fast mode, across the swing, in the positions along it.

    The axes of a table are not stated, and the line of the swing is not at a right angle to the fast mode.
    The decay is unchanged where that line is not known at all times.
    """
    if followed.problem:
        return followed
    period_s = summarise_decay(turning_points(followed.swings)).period_s.value
    seen = joined(followed.deflections, DeflectionUnit.RAD)
    part = fast_mode_ratio(seen.times_ns, seen.y, seen.x, period_s)
    if not part:
        return followed
    alone = replace(seen, y=seen.y - part * seen.x, u_y=np.hypot(seen.u_y, part * seen.u_x))
    passing = PassingDeflections([alone], DeflectionUnit.RAD)
    return replace(followed, swings=swings_of_blocks(passing), deflections=passing)


def _both_deflections(
    times_ns: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64], scatter: SampleScatter
) -> Deflections:
    """Deflections along the motion, y, and across it; NaN across where a table has one position alone."""
    samples = slow_deflections(times_ns, y, scatter.u_deflection)
    if not np.isfinite(x).any():
        return samples
    u_x = np.full(len(x), max(scatter.noise, estimate_noise(times_ns, x)))
    return replace(samples, x=x, u_x=u_x)


def _taken_as_exact(config: Configuration) -> list[str]:
    """Notes on what a table's budget takes as exact: the scale of its angles, that of its times."""
    lines = []
    if config.lever is None:
        lines.append(
            "the budget takes the table's angles as exact; [lever] u_arm_m states the u of their scale"
        )
    if config.timebase is None or config.timebase.u_camera_rate == 0:
        lines.append(
            "the budget takes the table's times as exact; [timebase] u_camera_rate states the relative u of "
            "their second (a clock that nobody compared may be off by 50 ppm: 5e-5)"
        )
    return lines


def separate_decays(swings: Sequence[HalfCycle]) -> list[list[HalfCycle]]:
    """The half-cycles of every decay, in order.

    A decay begins with the first half-cycle, with one in which the detector saw a release or a kick, and
    where an amplitude is clearly larger than the one before.
    """
    decays: list[list[HalfCycle]] = []
    before: HalfCycle | None = None
    for swing in swings:
        released = bool(swing.flags & HalfCycleFlag.START) and before is not None
        if not decays or released or (before is not None and _is_pushed(before, swing)):
            decays.append([])
            before = None
        decays[-1].append(swing)
        if not swing.flags:
            before = swing
    return decays


def _is_pushed(before: HalfCycle, swing: HalfCycle) -> bool:
    """Whether an unflagged half-cycle is clearly larger than the unflagged one before it."""
    grown = swing.amplitude - before.amplitude
    return (
        not swing.flags
        and swing.amplitude > _MIN_PUSHED_RATIO * before.amplitude
        and grown > _MIN_PUSHED_U * hypot(swing.u_amplitude, before.u_amplitude)
    )
