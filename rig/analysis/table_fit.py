"""`rig fit` on a table: swings, decay and period of any instrument, the contact's laws where they apply."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.decay_summary import DecaySummary, summarise_decay
from processing.deflections import slow_deflections
from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import Swing, SwingDetector, estimate_noise, turning_points
from rig.analysis.contact_laws import DecayFits, fit_decay, settled_swings
from rig.analysis.contact_verdicts import fit_results
from rig.analysis.fit_tables import parameter_table, quality_table
from rig.analysis.position_table import Trajectory, read_trajectory
from rig.analysis.results import TableResults
from rig.analysis.results_file import RESULTS_NAME, write_results
from rig.instrument import pendulum_on_ball
from rig.presentation import print_tables, with_uncertainty
from rig.settings import Configuration, load_configuration

_USABLE = 4


@dataclass(frozen=True)
class AnalysedTable:
    """A table, the half-cycles and the noise of a sample found in it, and what follows."""

    trajectory: Trajectory
    swings: Sequence[Swing]
    summary: DecaySummary
    noise: float
    results: TableResults


def analyse_table(
    path: Path, config: Configuration | None, time: str | None, positions: Sequence[str], unit: str
) -> AnalysedTable:
    """Detect the swings of a trajectory; fit the laws where unit and pendulum allow.

    Two positions are first turned onto the direction of the larger motion. Raises DataError where no decay
    can be had, with the reason.
    """
    trajectory = read_trajectory(path, time, list(positions), unit)
    scale = trajectory.scale_rad or 1.0
    deflection = along_motion(trajectory.positions) * scale
    noise = estimate_noise(trajectory.times_ns, deflection)
    detector = SwingDetector()
    swings = detector.update(trajectory.times_ns, deflection, np.full(len(deflection), noise))
    swings += detector.finish()
    points = turning_points(swings)
    if len(points) < _USABLE:
        flagged = len(swings) - len(points)
        raise DataError(
            f"{path}: {len(points)} usable half-cycles ({flagged} more are flagged), at least {_USABLE} are "
            "needed: the samples hold no free decay, or too little of one"
        )
    summary = summarise_decay(points)
    laws = DecayFits({}, None, _why_no_laws(trajectory, config))
    if config is not None and not laws.problem:
        pendulum = pendulum_on_ball(config)
        deflections = slow_deflections(trajectory.times_ns, deflection, noise)
        settled = settled_swings(swings, [deflections], deflections.unit, pendulum, config.fit)
        points = turning_points(settled.swings)
        laws = fit_decay(points, pendulum, config.fit, settled.exact)
    results = _results(path, trajectory, summary, laws)
    return AnalysedTable(trajectory, swings, summary, noise / scale, results)


def fit_trajectory(
    path: Path,
    output: Path | None,
    config_path: Path | None,
    time: str | None,
    positions: list[str],
    unit: str,
    overrides: Sequence[str],
) -> int:
    """Analyse a table, print decay, period and fits, write results.json. Returns the exit status."""
    config = load_configuration(config_path, overrides) if config_path else None
    table = analyse_table(path, config, time, positions, unit)
    _print(path, table)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_results(output / RESULTS_NAME, table.results)
        print(f"results      {output / RESULTS_NAME}")
    return 0


def along_motion(positions: tuple[NDArray[np.float64], ...]) -> NDArray[np.float64]:
    """Position (n,) along the motion: a single one unchanged, of two the component of the largest variance.

    Raises DataError if there is no sample with both positions.
    """
    if len(positions) == 1:
        return positions[0]
    both = np.column_stack(positions)
    centred = both - np.nanmean(both, axis=0)
    good = np.isfinite(centred).all(axis=1)
    if not good.any():
        raise DataError("no row of the table has both positions; name other columns with --position")
    _, _, axes = np.linalg.svd(centred[good], full_matrices=False)
    along: NDArray[np.float64] = centred @ axes[0]
    return along


def _why_no_laws(trajectory: Trajectory, config: Configuration | None) -> str:
    if trajectory.scale_rad is None:
        return f"the unit {trajectory.unit!r} is no angle; the contact's laws need one (--unit arcsec)"
    if config is None:
        return "no pendulum is known; --config FILE with [pendulum] gives mass and ball"
    return ""


def _print(path: Path, table: AnalysedTable) -> None:
    trajectory, summary, results = table.trajectory, table.summary, table.results
    scale = trajectory.scale_rad or 1.0
    unit = trajectory.unit
    print(f"{path}: {len(trajectory.times_ns)} samples, {', '.join(trajectory.names)} in {unit}")
    if trajectory.skipped_rows:
        print(f"  {trajectory.skipped_rows} rows without the right number of columns were left out")
    print(f"  noise of a sample {table.noise:.3g} {unit}, from the scatter about a smooth curve")
    flagged = len(table.swings) - summary.half_cycles
    print(
        f"  {summary.half_cycles} half-cycles ({flagged} more flagged and left out), amplitude "
        f"{summary.initial_amplitude / scale:.4g} to {summary.final_amplitude / scale:.4g} {unit}"
    )
    period = with_uncertainty(summary.period_s, summary.u_period_s)
    decrement = with_uncertainty(summary.decrement, summary.u_decrement)
    print(f"  period {period} s (chi2/dof of a constant one {summary.period_chi2_per_dof:.3g})")
    print(f"  log decrement {decrement} (chi2/dof of a constant one {summary.decrement_chi2_per_dof:.3g})")
    if math.pi < summary.decrement:
        print("  the decay is faster than a swing: no quality factor")
    else:
        q = math.pi / summary.decrement
        print(f"  quality factor {with_uncertainty(q, q * summary.u_decrement / summary.decrement)}")
    if results.fits:
        parameters = parameter_table(results.fits, results.surface_energy_j_per_m2, {})
        print_tables([parameters, quality_table(results.fits)])
    if results.problem:
        print(f"  contact: {results.problem}")


def _results(path: Path, trajectory: Trajectory, summary: DecaySummary, laws: DecayFits) -> TableResults:
    scale = trajectory.scale_rad or 1.0
    return TableResults(
        trajectory=path.as_posix(),
        unit=trajectory.unit,
        half_cycles=summary.half_cycles,
        initial_amplitude=summary.initial_amplitude / scale,
        final_amplitude=summary.final_amplitude / scale,
        period_s=Estimate(summary.period_s, summary.u_period_s),
        log_decrement=Estimate(summary.decrement, summary.u_decrement),
        fits={name: fit_results(fit) for name, fit in laws.fits.items()},
        surface_energy_j_per_m2=laws.surface_energy,
        problem=laws.problem,
    )
