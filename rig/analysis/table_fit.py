"""`rig fit` on a table: every decay in it, reported as a run of the rig is; or an envelope."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.digest import known_sha256_of_any
from processing.contact import StatedLaw
from processing.contact.laws import Law
from processing.decay_summary import DecaySummary, summarise_decay
from processing.deflections import Deflections, DeflectionUnit, slow_deflections
from processing.envelope import EnvelopeDecay, fit_envelope
from processing.errors import ConfigurationError, DataError
from processing.estimate import Estimate
from processing.fit import Witness
from processing.swing import (
    SampleScatter,
    Swing,
    SwingFlag,
    estimate_noise,
    estimate_scatter,
    swings_of,
    turning_points,
)
from processing.ticks import seconds
from rig.analysis.amplitude_damping import amplitude_damping
from rig.analysis.compared_laws import laws_of
from rig.analysis.decay_values import decay_values
from rig.analysis.motion_direction import along_and_across, direction_warning
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.position_table import TableColumns
from rig.analysis.results import EnvelopeResults, RunResults, TableDecay, TableResults
from rig.analysis.results_file import relative_record
from rig.analysis.second_frequency import fast_oscillation, second_frequency
from rig.analysis.stored_turning_points import StoredTurningPoints, TableUnit
from rig.analysis.surroundings import stated_surroundings
from rig.analysis.swings_fit import analyse_swings
from rig.analysis.trajectory import ANGLES, NOT_STATED, Trajectory
from rig.analysis.turning_plane import FollowedPlane, follow_plane
from rig.analysis.witness_file import FIRST_UTC_S, Begin, WitnessRecord
from rig.analysis.witnessed_fits import of_source
from rig.settings import Configuration

_USABLE = 4  # what the summary of a decay needs (processing/decay_summary.py)
_EDGE = 0.75
"""Samples of a decay: from so many half periods before its first turning point to as many after its last."""
_GROWN = 1.2
"""Ratio of neighbouring amplitudes from which on the pendulum was pushed again, and did not merely swing a
little further: 20 % of its amplitude are nearly half of its energy."""
_CLEARLY = 6.0
"""Standard uncertainties: by chance once in 10^9 half-cycles, where amplitudes are so faint that noise makes
them grow."""


@dataclass(frozen=True)
class FoundDecay:
    """One decay of a table: its half-cycles with their means, and its results."""

    swings: Sequence[Swing]
    summary: DecaySummary
    results: TableDecay


@dataclass(frozen=True)
class AnalysedTable:
    """A table, the noise of a sample in its unit, the decays found in it, and what follows."""

    trajectory: Trajectory
    noise: float
    decays: Sequence[FoundDecay]
    passed_over: Sequence[Sequence[Swing]]
    results: TableResults


def analyse_table(
    path: Path,
    config: Configuration | None,
    columns: TableColumns,
    witness: WitnessRecord | None = None,
    laws: Sequence[Law | StatedLaw] = (),
) -> AnalysedTable:
    """Detect the swings of a trajectory, separate its decays, and report each as a run of the rig.

    Two positions are first turned onto the direction of the larger motion. The contact's laws are fitted
    where unit and pendulum allow, and others beside it, with a `witness` of the ground where there is one.
    Raises DataError where no decay can be had, with the reason.
    """
    return analyse_trajectory(path, columns.read(path), config, laws, witness)


def analyse_trajectory(
    path: Path,
    trajectory: Trajectory,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw] = (),
    witness: WitnessRecord | None = None,
) -> AnalysedTable:
    """The same of positions that were read before, from a table or a film; `laws` are compared where one is
    fitted.
    """
    scale = trajectory.scale_rad or 1.0
    deflection, across = (one * scale for one in along_and_across(trajectory.positions))
    scatter = estimate_scatter(trajectory.times_ns, deflection)
    noise = scatter.noise
    swings = swings_of(trajectory.times_ns, deflection, scatter.u_deflection)
    parts = separate_decays(swings)
    usable = [part for part in parts if len(turning_points(part)) >= _USABLE]
    if not usable:
        most = max((len(turning_points(part)) for part in parts), default=0)
        reason = second_frequency(trajectory.times_ns, deflection) or (
            "the samples hold no free decay, or too little of one. "
            f"Time is {trajectory.time_name}, position {' and '.join(trajectory.names)}; --time and "
            "--position choose others"
        )
        raise DataError(
            f"{path}: {most} usable half-cycle{'' if most == 1 else 's'} ({len(swings) - most} more are "
            f"flagged or of other decays), at least {_USABLE} are needed: {reason}"
        )
    both = _in_both(trajectory.times_ns, across, deflection, scatter)
    decays = [_analyse(path, part, trajectory, both, scatter, config, laws, witness) for part in usable]
    longest = max(decays, key=lambda decay: decay.summary.half_cycles)
    results = TableResults(
        **_values(longest.results),
        trajectory=path.as_posix(),
        unit=trajectory.unit,
        understood=trajectory.understood,
        decays=tuple(decay.results for decay in decays),
    )
    passed_over = [part for part in parts if part not in usable]
    return AnalysedTable(trajectory, noise / scale, decays, passed_over, results)


def analyse_envelope(
    path: Path, columns: TableColumns, *, decibel: bool, frequency_hz: float | None
) -> tuple[EnvelopeDecay, EnvelopeResults]:
    """Fit the exponential of an envelope of amplitudes, or of powers in dB; see `fit_envelope`."""
    trajectory = columns.read(path)
    if len(trajectory.positions) > 1:
        raise ConfigurationError("--position was given twice; an envelope is one column")
    try:
        times_s = seconds(trajectory.times_ns)
        found = fit_envelope(times_s, trajectory.positions[0], decibel=decibel)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    warnings = []
    if found.changes:
        warnings.append(
            "the envelope is not one exponential: its time constant is "
            f"{found.first_s:.3g} s a quarter down the fall and {found.last_s:.3g} s three quarters down"
        )
    if not found.described:
        warnings.append(
            "constant, linear and quadratic damping together do not describe the envelope (χ²/dof "
            f"{found.damping.chi2_per_dof:.3g}); choose a stretch with --from and --to"
        )
    shown = (lambda amplitude: 20.0 * math.log10(amplitude)) if decibel else float
    return found, EnvelopeResults(
        envelope=path.as_posix(),
        unit="dB" if decibel else trajectory.unit,
        understood=trajectory.understood,
        samples=found.samples,
        time_constant_s=Estimate(found.tau_s, found.u_tau_s),
        first_half_s=found.first_s,
        last_half_s=found.last_s,
        chi2_per_dof=found.chi2_per_dof,
        noise_floor=found.floor,
        quality_factor=None if frequency_hz is None else Estimate(*found.quality_factor(frequency_hz)),
        damping=amplitude_damping(found.damping, frequency_hz, shown),
        warnings=tuple(warnings),
    )


def _analyse(
    path: Path,
    swings: Sequence[Swing],
    trajectory: Trajectory,
    deflections: Deflections,
    scatter: SampleScatter,
    config: Configuration | None,
    laws: Sequence[Law | StatedLaw],
    witness: WitnessRecord | None,
) -> FoundDecay:
    """One decay, by the same path as a record's."""
    u_common = trajectory.u_common_in_noises * scatter.noise
    edge_ns = _EDGE * 0.5e9 * summarise_decay(turning_points(swings)).period_s.value
    inside = (trajectory.times_ns > swings[0].turn_time_ns - edge_ns) & (
        trajectory.times_ns < swings[-1].turn_time_ns + edge_ns
    )
    passing = PassingDeflections([deflections[inside]], DeflectionUnit.RAD)
    followed = follow_plane(swings, passing, None, along_line=True)
    as_detected, swings = swings, followed.swings
    deflection = np.concatenate([block.y for block in followed.deflections])
    points = turning_points(swings)
    summary = summarise_decay(points)
    problem = _why_no_laws(trajectory, config)
    run = RunResults(
        record=relative_record(path, Path.cwd()), sha256=known_sha256_of_any(path), problem=problem
    )
    if config is not None and not problem:

        def beside(turn_time_ns: int) -> tuple[Witness, bool]:
            assert witness is not None
            in_file_ns = turn_time_ns + trajectory.first_ns
            absolute = seconds(trajectory.first_ns) > FIRST_UTC_S
            return witness.beside(Begin(in_file_ns, in_file_ns if absolute else None))

        at = None if witness is None else beside
        air = stated_surroundings(config)
        fitted = analyse_swings(
            path,
            as_detected,
            config,
            passing,
            air,
            witness=at,
            u_common_rad=u_common,
            followed=followed,
        )
        run = replace(fitted.results, laws=laws_of(fitted, laws)) if laws else fitted.results
        run = replace(run, witness=of_source(run.witness, witness))
    unflagged = [swing.turn_time_ns for swing in swings if not swing.flags]
    scale = trajectory.scale_rad or 1.0
    oscillation = fast_oscillation(
        trajectory.times_ns[inside],
        deflection,
        [position[inside] for position in trajectory.positions],
        trajectory.names,
        summary.period_s.value,
    )
    values = (
        _values(run)
        | decay_values(points, summary, scale, u_common=u_common)
        | {
            "frames": int(np.count_nonzero(inside)),
            "half_cycles": run.half_cycles or summary.half_cycles,
            "amplitude_unit": trajectory.unit,
            "initial_amplitude": summary.initial_amplitude / scale,
            "final_amplitude": summary.final_amplitude / scale,
            "warnings": (
                *run.warnings,
                *filter(None, [_direction_warning(trajectory, inside, run, followed)]),
                *filter(None, [oscillation]),
                *_changes(summary, scale),
            ),
        }
    )
    notes = [followed.text if followed.text not in run.notes else ""]
    if scatter.jitter_s > 0:
        notes.append(
            f"the times jitter by {1e3 * scatter.jitter_s:.2g} ms, as stamps of a host do: what that moves "
            "the samples by is in their uncertainties"
        )
    values["notes"] = (*run.notes, *filter(None, notes))
    if run.turning_points is None:
        unit = TableUnit.OWN if trajectory.scale_rad is None else DeflectionUnit.RAD
        values["turning_points"] = StoredTurningPoints.of(points, swings, unit, 1.0)
    if config is not None and config.lever is None and run.budget:
        values["notes"] = (
            *values["notes"],
            "the budget takes the table's angles as exact; [lever] u_arm_m states the u of their scale",
        )
    results = TableDecay(
        **values,
        began_s=seconds(unflagged[0]),
        ended_s=seconds(unflagged[-1]),
        run=trajectory.run,
    )
    return FoundDecay(swings, summary, results)


def _in_both(
    times_ns: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64], scatter: SampleScatter
) -> Deflections:
    """Deflections along the motion, y, and across it; NaN across where a table has one position alone."""
    samples = slow_deflections(times_ns, y, scatter.u_deflection)
    if not np.isfinite(x).any():
        return samples
    u_x = np.full(len(x), max(scatter.noise, estimate_noise(times_ns, x)))
    return replace(samples, x=x, u_x=u_x)


def _direction_warning(
    trajectory: Trajectory, inside: NDArray[np.bool_], run: RunResults, followed: FollowedPlane
) -> str:
    """What is to be said of a direction that no fit has followed, or could not; empty: nothing."""
    if followed.problem:
        return "" if run.problem == followed.problem else followed.problem
    of_instrument = run.instrument is not None and run.instrument.swing_plane is not None
    if followed.is_turned or of_instrument:
        return ""
    return direction_warning(trajectory.positions, inside)


def _changes(summary: DecaySummary, scale: float) -> list[str]:
    """What a mean does not describe."""
    said = []
    if summary.grows:
        said.append(
            f"the amplitude grows, {summary.initial_amplitude / scale:.4g} to "
            f"{summary.final_amplitude / scale:.4g}: this is no free decay; is time reversed, or does "
            "something drive the pendulum?"
        )
    for name, mean, unit in (
        ("period", summary.period_s, " s"),
        ("logarithmic decrement", summary.decrement, ""),
    ):
        if mean.changes:
            ends = (
                f": {mean.first:.5g}{unit} over the first third of the half-cycles, {mean.last:.5g}{unit} "
                "over the last"
                if np.isfinite(mean.first)
                else ""
            )
            said.append(
                f"the {name} is not constant (χ²/dof {mean.chi2_per_dof:.3g} if it were){ends}; the "
                "uncertainty of its mean allows for it"
            )
    return said


def _values(results: RunResults) -> dict[str, Any]:
    return {field.name: getattr(results, field.name) for field in fields(results)}


def _why_no_laws(trajectory: Trajectory, config: Configuration | None) -> str:
    if trajectory.scale_rad is None:
        if trajectory.unit == NOT_STATED:
            return f"the unit of the position is not stated; --unit takes {', '.join(ANGLES)}, or any word"
        near = get_close_matches(trajectory.unit, ANGLES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"--unit takes {', '.join(ANGLES)}"
        return f"the laws need an angle, but the unit is {trajectory.unit!r}; {hint}"
    if config is None:
        return "the pendulum is not described; --config FILE with [pendulum] gives mass and ball"
    return ""


def separate_decays(swings: Sequence[Swing]) -> list[list[Swing]]:
    """The half-cycles of every decay, in order.

    A decay begins with the first half-cycle, with one in which the detector saw a release or a kick, and
    where an amplitude is clearly larger than the one before.
    """
    decays: list[list[Swing]] = []
    before: Swing | None = None
    for swing in swings:
        released = bool(swing.flags & SwingFlag.START) and before is not None
        if not decays or released or (before is not None and _pushed(before, swing)):
            decays.append([])
            before = None
        decays[-1].append(swing)
        if not swing.flags:
            before = swing
    return decays


def _pushed(before: Swing, swing: Swing) -> bool:
    """Whether an unflagged half-cycle is clearly larger than the unflagged one before it."""
    grown = swing.amplitude - before.amplitude
    return (
        not swing.flags
        and swing.amplitude > _GROWN * before.amplitude
        and grown > _CLEARLY * hypot(swing.u_amplitude, before.u_amplitude)
    )
