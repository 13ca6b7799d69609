"""Table and figure of `rig plan`: uncertainties of planned runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from acquisition import atomic_write
from processing.contact import DRAG
from processing.errors import DataError
from processing.fit import PlannedRun, planned_run
from processing.units import ARCSEC_RAD
from rig.report.planned_run import PlannedContact
from rig.terminal import Table, TableRow, answer, palette, percent, plain, quantity

if TYPE_CHECKING:
    from rig.report.drawing import ReportFigure

_LINE_STYLES = ("-", "--", ":", "-.")


@dataclass(frozen=True, slots=True)
class Plan:
    """Planned runs of an assumed contact, each made as often as each of `counts` says.

    Runs that last longer than the assumed limit are still planned to their last amplitude.
    """

    assumed: PlannedContact
    runs: tuple[PlannedRun, ...]
    counts: tuple[int, ...] = (1,)

    @property
    def scales(self) -> dict[str, float]:
        """Values to which uncertainties are relative; 0 for a drag below its uncertainty in every run."""
        values = self.assumed.values
        hidden = all(run.u.get(DRAG.key, 0.0) > abs(values.get(DRAG.key, 0.0)) for run in self.runs)
        return {name: 0.0 if name == DRAG.key and hidden else value for name, value in values.items()}

    def u_after(self, run: PlannedRun, count: int) -> Mapping[str, float]:
        """Uncertainty by parameter after so many such runs."""
        return run.u_after(count, self.assumed.conditions.known_drag_s)

    def relative(self, run: PlannedRun, count: int) -> dict[str, float]:
        """Relative uncertainty by parameter after so many runs; infinite where the reference value is 0."""
        scales, u_after = self.scales, self.u_after(run, count)
        return {name: u / abs(scales[name]) if scales[name] else math.inf for name, u in u_after.items()}


def make_plan(
    planned: PlannedContact,
    first_arcsec: Sequence[float],
    last_arcsec: Sequence[float],
    ground_rad_per_s2_rthz: float | None = None,
    counts: Sequence[int] = (1,),
    seismometer_noise: float | None = None,
) -> Plan:
    """Plan runs between all first and last amplitudes, in series of `counts`.

    Raises DataError: no pair of amplitudes makes a run.
    """
    conditions = planned.conditions
    if ground_rad_per_s2_rthz is not None:
        conditions = conditions.on_ground(ground_rad_per_s2_rthz)
    if seismometer_noise is not None:
        conditions = replace(conditions, seismometer_noise=seismometer_noise)
    runs, problem = [], "every last amplitude must lie below every first one"
    for first, last in product(first_arcsec, last_arcsec):
        if last < first:
            try:
                ends_rad = first * ARCSEC_RAD, last * ARCSEC_RAD
                runs.append(planned_run(planned.values, planned.pendulum, conditions, *ends_rad))
            except DataError as error:
                problem = str(error)
    if not runs:
        raise DataError(f"no such run: {problem}")
    return Plan(planned._replace(conditions=conditions), tuple(runs), tuple(sorted(set(counts))))


def _share(u: float, value: float, unit: str) -> str:
    """Relative uncertainty in per cent; the uncertainty with its unit if the value is 0."""
    if not value:
        return f"{plain(u, 2)} {unit}".rstrip()
    share = u / abs(value)
    return percent(share) if share < 10 else "unknown"


def plan_table(plan: Plan) -> Table:
    """Table with a row for each run or series: time of all runs, relative uncertainties of parameters."""
    names, scales, conditions = list(plan.runs[0].u), plan.scales, plan.assumed.conditions
    rows = []
    for run, count in product(plan.runs, plan.counts):
        first, last = run.first_rad / ARCSEC_RAD, run.last_rad / ARCSEC_RAD
        all_s, u = count * run.duration_s, list(plan.u_after(run, count).values())
        remark = "" if run.complete else " (the ground ends it earlier)"
        remark += "" if run.duration_s <= plan.assumed.longest_s else " *"
        shares = [_share(one, scales[name], quantity(name).unit) for name, one in zip(names, u, strict=True)]
        texts = [f"{first:g} to {last:g}{remark}", f"{count}", f"{all_s / 60:.1f}", *shares]
        rows.append(TableRow([first, last, run.duration_s, run.half_cycles, count, all_s, *u], texts))
    note = ""
    if plan.assumed.unknown:
        unknown = ", ".join(quantity(name).symbol for name in plan.assumed.unknown)
        note = (
            f"NOT RELIABLE: what this plan starts from does not determine {unknown}, so the contact may be "
            "another; plan from a longer run, or from a configuration. "
        )
    note += (
        "Standard uncertainties from the swings alone, in per cent of the value where no unit is given; "
        "total time of all runs. One amplitude is measured to "
        f"{plain(conditions.u_amplitude_rad / ARCSEC_RAD, 2)} arcsec; the drive of the ground is "
        f"{plain(conditions.ground_rad_per_s2_rthz, 2)} rad/s²/√Hz"
    )
    if conditions.seismometer_noise is not None:
        note += f", {plain(conditions.unknown_rad_per_s2_rthz, 2)} with the seismometer"
    note += "."
    if any(run.duration_s > plan.assumed.longest_s for run in plan.runs):
        note += (
            f" * session.max_duration_s = {plan.assumed.longest_s:g} would end it earlier: raise it for this."
        )
    columns = ("first_arcsec", "last_arcsec", "duration_s", "half_cycles", "runs", "rig_time_s")
    symbols = [f"u({quantity(name).symbol})" for name in names]
    return Table(
        "plan", "Expected uncertainties", (*columns, *(f"u_{name}" for name in names)),
        ("amplitudes, arcsec", "runs", "min", *symbols), rows, note,
    )  # fmt: skip


def save_plan(plan: Plan, folder: Path) -> None:
    """Write plan.csv, .png and .svg to a folder, which is made if needed; none may exist."""
    from rig.report.drawing import png, styled, svg

    folder.mkdir(parents=True, exist_ok=True)
    with styled():
        drawing = plan_figure(plan)
        contents = {".csv": plan_table(plan).csv().encode(), ".png": png(drawing), ".svg": svg(drawing)}
    for suffix, content in contents.items():
        path = folder / f"plan{suffix}"
        atomic_write.write_new(path, content)
        answer(written=[path])
        print(f"{'plan':<12} {path}")


def plan_figure(plan: Plan) -> "ReportFigure":
    """Uncertainty against last amplitude and against time: a colour for each parameter, a line style for each
    first amplitude."""
    from matplotlib.lines import Line2D

    from rig.report.drawing import INK, ReportFigure, canvas

    figure = canvas(3.4)
    by_amplitude, by_time = figure.subplots(1, 2, sharey=True)
    starts = sorted({run.first_rad for run in plan.runs}, reverse=True)
    for style, first in zip(_LINE_STYLES, starts, strict=False):
        runs = sorted((run for run in plan.runs if run.first_rad == first), key=lambda run: run.duration_s)
        last = [run.last_rad / ARCSEC_RAD for run in runs]
        for colour, name in zip(palette.SEQUENCE, plan.runs[0].u, strict=False):
            label = quantity(name).symbol if first == starts[0] else None
            for rank, count in enumerate(plan.counts):
                u_percent = np.array([100 * plan.relative(run, count)[name] for run in runs])
                if not np.all(np.isfinite(u_percent)):
                    continue
                if rank == 0:
                    by_amplitude.plot(last, u_percent, style, color=colour, marker=".", label=label)
                minutes = [count * run.duration_s / 60 for run in runs]
                opacity = 1.0 if rank == 0 else 0.45
                by_time.plot(minutes, u_percent, style, color=colour, marker=".", alpha=opacity)
    by_amplitude.set(xscale="log", yscale="log")
    by_amplitude.invert_xaxis()
    last_arcsec = sorted({run.last_rad / ARCSEC_RAD for run in plan.runs})
    by_amplitude.set_xticks(last_arcsec, [f"{last:g}" for last in last_arcsec])
    by_amplitude.set_xticks([], minor=True)
    by_amplitude.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    by_amplitude.set_xlabel("last amplitude / arcsec")
    by_time.set_xlabel("time of all runs / min")
    by_amplitude.set_ylabel("u / value, %")
    by_amplitude.legend(ncols=2)
    styles = [Line2D([], [], color=INK, ls=style) for style in _LINE_STYLES[: len(starts)]]
    by_time.legend(styles, [f"from {first / ARCSEC_RAD:g}″" for first in starts])
    figure.subplots_adjust(left=0.09, right=0.985, bottom=0.14, top=0.97, wspace=0.05)
    plural = "s" if plan.counts[0] > 1 else ""
    others = ", ".join(str(count) for count in plan.counts[1:])
    caption = f"Relative standard uncertainty of every parameter after {plan.counts[0]} run{plural}" + (
        f"; on the right, faint: {others} runs." if others else "."
    )
    return ReportFigure("plan", "Expected uncertainties", caption, figure)
