"""Analysis of a table by `rig fit`: every decay in it as a run of the rig."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path

import numpy as np

from acquisition.record.digest import cached_sha256, utc
from processing.contact import StatedLaw
from processing.contact.laws import Law
from processing.decay_summary import MIN_TURNING_POINTS, summarise_decay
from processing.deflections import Deflections, DeflectionUnit, joined, slow_deflections
from processing.errors import DataError
from processing.swing import (
    HalfCycle,
    HalfCycleFlag,
    SampleScatter,
    estimate_noise,
    estimate_scatter,
    half_cycles_of,
    half_cycles_of_blocks,
    turning_points,
)
from processing.units import ARCSEC_RAD, seconds
from rig.analysis.ambient import ambient_warnings, stated_ambient
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

_SESSION_KEYS = ("sample", "operator", "contact_history", "notes")
_EDGE_HALF_PERIODS = 0.75
"""Half periods before the first and after the last turning point of a decay whose samples belong to it."""
_MIN_PUSHED_RATIO = 1.2
"""Ratio of neighbouring amplitudes above which the pendulum was pushed again: 20 % of its amplitude are
nearly half of its energy."""
_MIN_PUSHED_U = 6.0
"""Standard uncertainties by which such an amplitude is larger; noise does that once in 10^9 half-cycles."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class AnalysedTable(SessionResults):
    """The results of a table, with values for its report that are in no file."""

    runs: tuple[AnalysedRun, ...]
    positions: Trajectory
    """The positions that were read."""
    noise: float
    """Noise of a sample in the unit of the positions."""
    short_decays: Sequence[Sequence[HalfCycle]]
    """Decays of too few usable half-cycles."""

    @property
    def longest(self) -> AnalysedRun:
        """The decay with most half-cycles."""
        return max(self.runs, key=lambda run: len(turning_points(run.detected_half_cycles)))


def analyse_trajectory(
    path: Path,
    trajectory: Trajectory,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw] = (),
    seismometer: SeismometerRecord | None = None,
) -> AnalysedTable:
    """Results of positions that were read from a table or a film.

    Half-cycles are detected, decays separated, and each is analysed as a run is. Two positions are first
    turned onto the direction of the larger motion. The contact's law is fitted where unit and pendulum allow,
    with the auxiliary `seismometer` if there is one, and compared with further `laws`. Raises DataError with
    the reason where there is no decay.
    """
    judge_sign(path, trajectory)
    scale = trajectory.scale_rad or 1.0
    along, across = (axis * scale for axis in along_and_across(trajectory.positions))
    scatter = estimate_scatter(trajectory.times_ns, along)
    half_cycles = half_cycles_of(trajectory.times_ns, along, scatter.u_deflection)
    decays = separate_decays(half_cycles)
    usable = [decay for decay in decays if len(turning_points(decay)) >= MIN_TURNING_POINTS]
    if not usable:
        judge_time_unit(path, trajectory)
        count = max((len(turning_points(decay)) for decay in decays), default=0)
        columns = f"Time is {trajectory.time_name}, position {' and '.join(trajectory.names)}"
        remedy = trajectory.remedy or f"{columns}; --time and --position choose others"
        raise DataError(
            f"{path}: {count} usable half-cycle{'' if count == 1 else 's'} ({len(half_cycles) - count} more "
            f"are flagged or of other decays), at least {MIN_TURNING_POINTS} are needed: the samples hold no "
            "free decay, too little of one, or a second oscillation as large, which has to be filtered. "
            f"{remedy}"
        )
    judge_time_unit(path, trajectory, usable)
    both = slow_deflections(trajectory.times_ns, along, scatter.u_deflection)
    if np.isfinite(across).any():
        u_across = max(scatter.noise, estimate_noise(trajectory.times_ns, across))
        both = replace(both, x=across, u_x=np.full(len(across), u_across))
    runs = tuple(
        _analyse(path, decay, trajectory, both, scatter, config, laws, seismometer) for decay in usable
    )
    # decays of one run are numbered by the run's number if it has one, else in their order
    numbers = [int(trajectory.run)] * len(runs) if trajectory.run.isdecimal() else ()
    return AnalysedTable(
        trajectory=path.as_posix(),
        unit=trajectory.unit,
        understood=trajectory.understood,
        runs=runs,
        series=instrument_series(runs, numbers),
        positions=trajectory,
        noise=scatter.noise / scale,
        short_decays=[decay for decay in decays if decay not in usable],
    )


def series_of_runs(path: Path, tables: Mapping[str, AnalysedTable]) -> SessionResults | None:
    """Results of several runs, by name, with their series; None where there is no series.

    The numbers in `reference_runs` are the names of the runs if all are numbers, else 1, 2, ... in their
    order.
    """
    are_numbers = all(map(str.isdecimal, tables))
    names = [int(name) if are_numbers else order for order, name in enumerate(tables, start=1)]
    numbers = [number for number, table in zip(names, tables.values(), strict=True) for _ in table.runs]
    runs = tuple(run for table in tables.values() for run in table.runs)
    series = instrument_series(runs, numbers)
    if series is None:
        return None
    return replace(next(iter(tables.values())), trajectory=path.as_posix(), runs=runs, series=series)


def _analyse(
    path: Path,
    half_cycles: Sequence[HalfCycle],
    trajectory: Trajectory,
    deflections: Deflections,
    scatter: SampleScatter,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw],
    seismometer: SeismometerRecord | None,
) -> AnalysedRun:
    """Results of one decay, by the same steps as those of a record."""
    times_ns, scale = trajectory.times_ns, trajectory.scale_rad or 1.0
    u_common = trajectory.u_common_over_noise * scatter.noise
    edge_ns = _EDGE_HALF_PERIODS * 0.5e9 * summarise_decay(turning_points(half_cycles)).period_s.value
    inside = (times_ns > half_cycles[0].turn_time_ns - edge_ns) & (
        times_ns < half_cycles[-1].turn_time_ns + edge_ns
    )
    passing = PassingDeflections([deflections[inside]], DeflectionUnit.RAD)
    followed = _without_fast_mode(follow_plane(half_cycles, passing, None, along_line=True))
    half_cycles = followed.half_cycles
    points = turning_points(half_cycles)
    summary = summarise_decay(points)
    problem = missing_for_laws(trajectory, config)
    sha256 = cached_sha256(path)
    run = AnalysedRun(path=path, record=relative_record(path, Path.cwd()), sha256=sha256, problem=problem)
    utc_ns = trajectory.first_ns if seconds(trajectory.first_ns) > FIRST_UTC_S else None
    if config is not None and not problem:
        if seismometer is not None:
            seismometer = replace(seismometer, to_file_ns=trajectory.first_ns, to_utc_ns=utc_ns)
        air = stated_ambient(config)
        run = analyse_swings(path, followed, config, air, seismometer=seismometer, u_common_rad=u_common)
        run = with_laws(run, laws) if laws else run
    unflagged_ns = [h.turn_time_ns for h in half_cycles if not h.flags]
    # without the time in which the pendulum is held or pushed
    free = times_ns[inside] >= unflagged_ns[0]
    along = np.concatenate([block.y for block in followed.deflections])
    oscillation = fast_oscillation(times_ns[inside][free], along[free], summary.period_s.value)
    values = decay_values(points, scale, u_common=u_common)
    warnings = [
        *run.warnings,
        *filter(None, ["" if followed.problem == run.problem else followed.problem, oscillation]),
        *decay_warnings(summary),
    ]
    for name, positions in zip(trajectory.names, trajectory.positions, strict=True):
        warnings += clipping_warnings(name, positions[inside])
    notes = [followed.text if followed.text not in run.notes and run.instrument is None else ""]
    if scatter.jitter_s > 0:
        notes.append(
            f"the times jitter by {1e3 * scatter.jitter_s:.2g} ms, as stamps of a host do: what that moves "
            "the samples by is in their uncertainties"
        )
    unit = TableUnit.OWN if trajectory.scale_rad is None else DeflectionUnit.RAD
    session: dict[str, str] = {}
    if config is not None:
        ambient = stated_ambient(config, None if utc_ns is None else utc(utc_ns))
        run = replace(run, ambient=ambient)
        session = {key: text for key in _SESSION_KEYS if (text := getattr(config.session, key))}
        warnings += ambient_warnings(ambient)
        warnings += strange_amplitudes(points.amplitude / ARCSEC_RAD, trajectory, config)
        notes += _exact_scale_notes(config) if run.budget else []
    return replace(
        run,
        detected_half_cycles=half_cycles,
        table=(*run.table, *decay_rows(points, values, trajectory.unit, scale, path.stem)),
        frames=int(np.count_nonzero(inside)),
        half_cycles=run.half_cycles or summary.half_cycles,
        amplitude_unit=trajectory.unit,
        damping=values.damping,
        warnings=tuple(warnings),
        notes=(*run.notes, *filter(None, notes)),
        turning_points=run.turning_points or StoredTurningPoints.of(points, half_cycles, unit, 1.0),
        decay=TableDecay(
            began_s=seconds(unflagged_ns[0]),
            ended_s=seconds(unflagged_ns[-1]),
            run=trajectory.run,
            columns=trajectory.names,
            session=session,
        ),
    )


def _without_fast_mode(followed: FollowedPlane) -> FollowedPlane:
    """The decay with the fast mode's part removed from the positions along the swing."""
    # where the line of the swing is not known at all times, its angle to the fast mode is not, either
    if followed.problem:
        return followed
    period_s = summarise_decay(turning_points(followed.half_cycles)).period_s.value
    both = joined(followed.deflections, DeflectionUnit.RAD)
    ratio = fast_mode_ratio(both.times_ns, both.y, both.x, period_s)
    if not ratio:
        return followed
    slow = replace(both, y=both.y - ratio * both.x, u_y=np.hypot(both.u_y, ratio * both.u_x))
    passing = PassingDeflections([slow], DeflectionUnit.RAD)
    return replace(followed, half_cycles=half_cycles_of_blocks(passing), deflections=passing)


def _exact_scale_notes(config: Configuration) -> list[str]:
    """Notes on the scales of angles and of times that a table's budget takes as exact."""
    angles = "the budget takes the table's angles as exact; [lever] u_arm_m states the u of their scale"
    times = (
        "the budget takes the table's times as exact; [timebase] u_camera_rate states the relative u of "
        "their second (a clock that nobody compared may be off by 50 ppm: 5e-5)"
    )
    has_exact_times = config.timebase is None or config.timebase.u_camera_rate == 0
    return [*([angles] if config.lever is None else []), *([times] if has_exact_times else [])]


def separate_decays(half_cycles: Sequence[HalfCycle]) -> list[list[HalfCycle]]:
    """The half-cycles of every decay, in order.

    A decay begins with the first half-cycle, with one in which the detector saw a release or a kick, and
    where an amplitude is clearly larger than the previous one.
    """
    decays: list[list[HalfCycle]] = [[]] if half_cycles else []
    previous: HalfCycle | None = None
    for half_cycle in half_cycles:
        if previous is not None:
            growth = half_cycle.amplitude - previous.amplitude
            is_pushed = (
                not half_cycle.flags
                and half_cycle.amplitude > _MIN_PUSHED_RATIO * previous.amplitude
                and growth > _MIN_PUSHED_U * hypot(half_cycle.u_amplitude, previous.u_amplitude)
            )
            if is_pushed or half_cycle.flags & HalfCycleFlag.START:
                decays.append([])
                previous = None
        decays[-1].append(half_cycle)
        previous = previous if half_cycle.flags else half_cycle
    return decays
