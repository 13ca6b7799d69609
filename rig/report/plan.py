"""The plan of `rig plan`: uncertainties of planned runs, and their table."""

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
    """Planned runs of an assumed contact, also those that last longer than the time limit."""

    contact: PlannedContact
    runs: tuple[PlannedRun, ...]
    counts: tuple[int, ...] = (1,)
    """Numbers of repetitions of each run, for which uncertainties are calculated."""

    @property
    def reference_values(self) -> dict[str, float]:
        """Values to which uncertainties are relative; 0 for a drag below its uncertainty in every run."""
        values = self.contact.values
        is_hidden = all(run.u.get(DRAG.key, 0.0) > abs(values.get(DRAG.key, 0.0)) for run in self.runs)
        return {name: 0.0 if name == DRAG.key and is_hidden else value for name, value in values.items()}

    def combined_u(self, run: PlannedRun, count: int) -> Mapping[str, float]:
        """Uncertainty by parameter of `count` such runs together."""
        return run.u_after(count, self.contact.conditions.known_drag_s)

    @property
    def rows(self) -> list[dict[str, float]]:
        """Amplitudes, duration and uncertainties of every planned run, for each number of repetitions."""
        return [
            {
                "first_arcsec": run.first_rad / ARCSEC_RAD,
                "last_arcsec": run.last_rad / ARCSEC_RAD,
                "duration_s": run.duration_s,
                "half_cycles": run.half_cycles,
                "runs": count,
                **{f"u_{name}": u for name, u in self.combined_u(run, count).items()},
            }
            for run, count in product(self.runs, self.counts)
        ]


def make_plan(
    contact: PlannedContact,
    first_arcsec: Sequence[float],
    last_arcsec: Sequence[float],
    ground_rad_per_s2_rthz: float | None = None,
    counts: Sequence[int] = (1,),
    seismometer_noise: float | None = None,
) -> Plan:
    """Plan runs between all first and last amplitudes; raises DataError if no pair of them makes a run."""
    conditions = contact.conditions
    if ground_rad_per_s2_rthz is not None:
        conditions = conditions.on_ground(ground_rad_per_s2_rthz)
    if seismometer_noise is not None:
        conditions = replace(conditions, seismometer_noise=seismometer_noise)
    runs, problem = [], "a last amplitude must lie below a first one"
    for first, last in product(first_arcsec, last_arcsec):
        if last < first:
            try:
                amplitudes_rad = first * ARCSEC_RAD, last * ARCSEC_RAD
                runs.append(planned_run(contact.values, contact.pendulum, conditions, *amplitudes_rad))
            except DataError as error:
                problem = str(error)
    if not runs:
        raise DataError(f"no such run: {problem}")
    return Plan(contact._replace(conditions=conditions), tuple(runs), tuple(sorted(set(counts))))


_MAX_RELATIVE_U = 10.0
"""Relative uncertainty from which on a value counts as unknown."""


def _relative_u_text(u: float, value: float, unit: str) -> str:
    """Relative uncertainty in per cent; the uncertainty with its unit if the value is 0."""
    if not value:
        return f"{plain(u, 2)} {unit}".rstrip()
    relative_u = u / abs(value)
    return percent(relative_u) if relative_u < _MAX_RELATIVE_U else "unknown"


def plan_table(plan: Plan) -> Table:
    """Table with a row for each run or series: time of all runs, relative uncertainties of parameters."""
    names, values, contact = list(plan.runs[0].u), plan.reference_values, plan.contact
    units = [quantity(name).unit for name in names]
    rows = []
    for run, count in product(plan.runs, plan.counts):
        first_arcsec, last_arcsec = run.first_rad / ARCSEC_RAD, run.last_rad / ARCSEC_RAD
        total_min, u = count * run.duration_s / 60, plan.combined_u(run, count).values()
        remark = "" if run.complete else " (the ground ends it earlier)"
        remark += "" if run.duration_s <= contact.longest_s else " *"
        relative = map(_relative_u_text, u, (values[name] for name in names), units)
        amplitudes = f"{first_arcsec:g} to {last_arcsec:g}{remark}"
        rows.append([amplitudes, f"{count}", f"{total_min:.1f}", *relative])
    note = ""
    if contact.unknown:
        unknown = ", ".join(quantity(name).symbol for name in contact.unknown)
        note = (
            f"NOT RELIABLE: what this plan starts from does not determine {unknown}, so the contact may be "
            "another; plan from a longer run, or from a configuration. "
        )
    conditions = contact.conditions
    note += (
        "Standard uncertainties from the swings alone, in per cent of the value where no unit is given; "
        "total time of all runs. One amplitude is measured to "
        f"{plain(conditions.u_amplitude_rad / ARCSEC_RAD, 2)} arcsec; the drive of the ground is "
        f"{plain(conditions.ground_rad_per_s2_rthz, 2)} rad/s²/√Hz"
    )
    if conditions.seismometer_noise is not None:
        note += f", {plain(conditions.unknown_rad_per_s2_rthz, 2)} with the seismometer"
    note += "."
    if any(run.duration_s > contact.longest_s for run in plan.runs):
        note += f" * session.max_duration_s = {contact.longest_s:g} would end it earlier: raise it for this."
    head = ("amplitudes, arcsec", "runs", "min", *(f"u({quantity(name).symbol})" for name in names))
    return Table("plan", "Expected uncertainties", head, rows, note)
