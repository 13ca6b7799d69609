"""Runs that tell a contact that ages: one after the other, from other amplitudes or after waiting."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan

from processing.angle import ARCSEC_RAD
from processing.fit import PlannedSeries, planned_series
from rig.plan.plan import Plan
from rig.presentation import Cell, Table, percent, quantity

_PER_HOUR = 3600.0
_LITTLE = 1.2
"""Factor on u(b) by which not knowing the age may enlarge it in runs that are proposed."""


@dataclass(frozen=True, slots=True)
class AgeingPlan:
    """The longest planned run by itself, and pairs of runs that begin with it; `proposed` is one of them.

    That is the shortest in which not knowing the age enlarges u(b) by less than a fifth; without one, the
    one that leaves u(b) smallest.
    """

    plan: Plan
    series: tuple[PlannedSeries, ...]
    proposed: PlannedSeries


def plan_ageing(plan: Plan, waits_s: Sequence[float]) -> AgeingPlan:
    """Pairs of the planned run that tells b best and every other that ends where it does, after waiting."""
    best = min(plan.runs, key=lambda run: run.u["b"])
    seconds = [run for run in plan.runs if run.last_rad == best.last_rad]
    spans = [[best], *([best, run] for run in sorted(seconds, key=lambda run: -run.first_rad))]
    series = []
    for runs in spans:
        for wait_s in sorted(set(waits_s)) if len(runs) > 1 else [0.0]:
            between = [(run.first_rad, run.last_rad) for run in runs]
            series.append(planned_series(plan.values, plan.pendulum, plan.conditions, between, wait_s))
    pairs = series[1:] or series
    good = [one for one in pairs if one.u["b"] < _LITTLE * one.u_steady["b"]]
    proposed = min(good, key=lambda one: one.duration_s) if good else min(pairs, key=lambda one: one.u["b"])
    return AgeingPlan(plan, tuple(series), proposed)


def _percent(share: float) -> str:
    return percent(share) if isfinite(share) and share < 10 else "not told"


def ageing_table(planned: AgeingPlan) -> Table:
    """A row for the run by itself and for every pair: time, and the uncertainties of b and of the ageing."""
    b = abs(planned.plan.values["b"])
    rows: list[list[Cell]] = []
    shown = []
    for one in planned.series:
        between = [(run.first_rad / ARCSEC_RAD, run.last_rad / ARCSEC_RAD) for run in one.runs]
        second = between[1][0] if len(between) > 1 else nan
        per_h = one.u_ageing_per_s * _PER_HOUR
        rows.append(
            [
                *between[0], second, one.waiting_s, one.duration_s, one.u_steady["b"], one.u["b"],
                one.u_ageing_per_s,
            ]
        )  # fmt: skip
        mark = " <- proposed" if one is planned.proposed and len(one.runs) > 1 else ""
        words = ", then ".join(f"{first:g} to {last:g}" for first, last in between)
        waiting = f"{one.waiting_s / 60:g}" if len(between) > 1 else ""
        shown.append(
            [
                words + mark, waiting, f"{one.duration_s / 60:.1f}", _percent(one.u_steady["b"] / b),
                _percent(one.u["b"] / b), _percent(per_h) + (" per h" if per_h < 10 else ""),
            ]
        )  # fmt: skip
    symbol = quantity("b").symbol
    return Table(
        "plan_ageing",
        "Runs that reveal ageing of the contact",
        (
            "first_arcsec", "last_arcsec", "second_first_arcsec", "waiting_s", "elapsed_s", "u_b_steady",
            "u_b", "u_ageing_per_s",
        ),
        rows,
        (
            "amplitudes, arcsec", "waiting, min", "elapsed, min", f"u({symbol}), no ageing",
            f"u({symbol}), unknown ageing", "u(ageing)",
        ),
        shown,
        "For friction that changes linearly with time at an unknown rate; the period of each run is free. "
        f"{symbol} refers to the middle of the elapsed time. A change of the air looks like ageing.",
    )  # fmt: skip
