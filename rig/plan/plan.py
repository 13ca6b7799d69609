"""Uncertainties of planned runs over their first and last amplitudes, as table and picture."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from acquisition import atomic_write
from processing.angle import ARCSEC_RAD
from processing.contact import DRAG, PendulumOnBall
from processing.errors import DataError
from processing.fit import Conditions, FitMethod, PlannedRun, planned_run
from rig.analysis import AnalysedRun
from rig.plan.expected import Expected
from rig.presentation import Cell, Table, answer, percent, plain, print_tables, quantity


@dataclass(frozen=True, slots=True)
class Plan:
    """Planned runs, and series of `counts` of each; `values` are the parameters they are planned for.

    Runs that last longer than `longest_s` are planned to their last amplitude all the same.
    """

    conditions: Conditions
    values: Mapping[str, float]
    runs: tuple[PlannedRun, ...]
    counts: tuple[int, ...] = (1,)
    longest_s: float = math.inf
    pendulum: PendulumOnBall | None = None

    @property
    def scales(self) -> dict[str, float]:
        """The values to which uncertainties are related; 0 for a drag that no run would tell from none."""
        unseen = all(run.u.get(DRAG.key, 0.0) > abs(self.values.get(DRAG.key, 0.0)) for run in self.runs)
        return {name: 0.0 if name == DRAG.key and unseen else value for name, value in self.values.items()}

    def relative(self, run: PlannedRun) -> dict[str, float]:
        """Uncertainty over value, by parameter; infinite where there is no value to relate it to."""
        scales = self.scales
        return {name: u / abs(scales[name]) if scales[name] else math.inf for name, u in run.u.items()}


def plan_runs(
    run: AnalysedRun,
    first_arcsec: Sequence[float],
    last_arcsec: Sequence[float],
    ground_rad_per_s2_rthz: float | None = None,
    counts: Sequence[int] = (1,),
    witness_noise: float | None = None,
) -> Plan:
    """Runs between all first and last amplitudes, with the contact, the noise and the ground of a run.

    Raises
    ------
    DataError
        The run has no fit, or no pair of amplitudes makes a run.
    """
    exact, pendulum = run.fits.get(FitMethod.EXACT), run.results.pendulum
    if exact is None or pendulum is None:
        raise DataError(f"{run.record}: a plan needs a fitted run: {run.results.problem or 'it has no fit'}")
    values = {name: exact.estimate(name).value for name in exact.contact_names}
    expected = Expected(values, pendulum, Conditions.of(exact, run.points))
    return plan_expected(expected, first_arcsec, last_arcsec, ground_rad_per_s2_rthz, counts, witness_noise)


def plan_expected(
    expected: Expected,
    first_arcsec: Sequence[float],
    last_arcsec: Sequence[float],
    ground_rad_per_s2_rthz: float | None = None,
    counts: Sequence[int] = (1,),
    witness_noise: float | None = None,
) -> Plan:
    """Runs between all first and last amplitudes, and series of so many of each.

    Raises
    ------
    DataError
        No pair of amplitudes makes a run.
    """
    values, pendulum, conditions, longest_s = expected
    if ground_rad_per_s2_rthz is not None:
        conditions = conditions.on_ground(ground_rad_per_s2_rthz)
    if witness_noise is not None:
        conditions = conditions.with_witness(witness_noise)
    runs = []
    problem = "every last amplitude must lie below every first one"
    for first in first_arcsec:
        for last in last_arcsec:
            if last < first:
                try:
                    runs.append(
                        planned_run(values, pendulum, conditions, first * ARCSEC_RAD, last * ARCSEC_RAD)
                    )
                except DataError as error:
                    problem = str(error)
    if not runs:
        raise DataError(f"no such run: {problem}")
    return Plan(conditions, values, tuple(runs), tuple(sorted(set(counts))), longest_s, pendulum)


def _share(u: float, value: float, unit: str) -> str:
    """An uncertainty over its value, or beside it where that is none: no drag."""
    return percent(u / abs(value)) if value else f"{plain(u, 2)} {unit}".rstrip()


def plan_table(plan: Plan) -> Table:
    """A row for every run or series: time of all runs, and the relative uncertainty of every parameter."""
    names = list(plan.runs[0].u)
    scales = plan.scales
    rows: list[list[Cell]] = []
    shown = []
    for run, count in product(plan.runs, plan.counts):
        first, last = run.first_rad / ARCSEC_RAD, run.last_rad / ARCSEC_RAD
        times, all_s = 1 / math.sqrt(count), count * run.duration_s
        u = [times * run.u[name] for name in names]
        rows.append([first, last, run.duration_s, run.half_cycles, count, all_s, *u])
        drowned = "" if run.complete else " (the ground ends it earlier)"
        drowned += "" if run.duration_s <= plan.longest_s else " *"
        shown.append(
            [f"{first:g} to {last:g}{drowned}", f"{count}", f"{all_s / 60:.1f}"]
            + [_share(times * run.u[name], scales[name], quantity(name).unit) for name in names]
        )
    too_long = ""
    if any(run.duration_s > plan.longest_s for run in plan.runs):
        too_long = f" * session.max_duration_s = {plan.longest_s:g} would end it earlier: raise it for this."
    conditions = plan.conditions
    witnessed = (
        ""
        if conditions.witness_noise is None
        else f", of which a witness leaves {plain(conditions.unknown_rad_per_s2_rthz, 2)}"
    )
    return Table(
        "plan",
        "Expected uncertainties",
        (
            *("first_arcsec", "last_arcsec", "duration_s", "half_cycles", "runs", "rig_time_s"),
            *(f"u_{name}" for name in names),
        ),
        rows,
        ("amplitudes, arcsec", "runs", "min", *(f"u({quantity(name).symbol})" for name in names)),
        shown,
        "Standard uncertainties from the swings alone, in per cent of the value where no unit is given; "
        "total time of all runs. One amplitude is measured to "
        f"{plain(conditions.u_amplitude_rad / ARCSEC_RAD, 2)} arcsec; the drive of the ground is "
        f"{plain(conditions.ground_rad_per_s2_rthz, 2)} rad/s²/√Hz{witnessed}.{too_long}",
    )


def print_plan(plan: Plan, ageing: Table | None = None) -> None:
    """The table on the terminal, and that of runs that tell a contact's age."""
    print_tables([plan_table(plan), *([] if ageing is None else [ageing])])


def save_plan(plan: Plan, folder: Path, ageing: Table | None = None) -> None:
    """plan.csv, plan.png, plan.svg, and plan.ageing.csv, in a folder, which is made; none may exist."""
    from rig.plan.figure import plan_figure
    from rig.report import png, styled, svg

    folder.mkdir(parents=True, exist_ok=True)
    with styled():
        drawing = plan_figure(plan)
        made = {".csv": plan_table(plan).csv().encode(), ".png": png(drawing), ".svg": svg(drawing)}
    if ageing is not None:
        made[".ageing.csv"] = ageing.csv().encode()
    for suffix, content in made.items():
        path = folder / f"plan{suffix}"
        atomic_write.write_new(path, content)
        answer(written=[path])
        print(f"{'plan':<12} {path}")
