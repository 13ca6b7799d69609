"""Table of `rig plan`: uncertainties of planned runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from processing.contact import DRAG
from processing.errors import DataError
from processing.fit import PlannedRun, planned_run
from processing.units import ARCSEC_RAD
from rig.report.planned_run import PlannedContact
from rig.terminal import Table, percent, plain, quantity


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

    @property
    def numbers(self) -> list[dict[str, float]]:
        """Every planned run, as often as each count says: its amplitudes, its duration, uncertainties."""
        return [
            {
                "first_arcsec": run.first_rad / ARCSEC_RAD,
                "last_arcsec": run.last_rad / ARCSEC_RAD,
                "duration_s": run.duration_s,
                "half_cycles": run.half_cycles,
                "runs": count,
                **{f"u_{name}": u for name, u in self.u_after(run, count).items()},
            }
            for run, count in product(self.runs, self.counts)
        ]


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
        rows.append(texts)
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
    head = ("amplitudes, arcsec", "runs", "min", *(f"u({quantity(name).symbol})" for name in names))
    return Table("plan", "Expected uncertainties", head, rows, note)
