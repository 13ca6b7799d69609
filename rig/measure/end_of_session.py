"""What a session that has ended hands over: how it went, the result, what limits it, what to do next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from processing.angle import ARCSEC_RAD
from processing.contact import DEFAULT_LAW
from processing.errors import DataError, RigError
from processing.estimate import Estimate
from processing.fit import Budget, FitMethod
from rig.analysis import RunResults, budget_of, curves_of, determined_text, read_results, results_path
from rig.measure.session_file import RunState, SessionState, read_session
from rig.presentation import SOURCES, quantity

_SHOWN_SHARE = 0.02
_LIMITS_FROM = 0.25
_ENERGY = "surface_energy_table2_j_per_m2"
_DO: Final[Mapping[str, str]] = {
    "swings": "measure longer or more often: state more runs",
    "ground": "measure while the ground is quieter, or record a witness of it (rig fit --witness)",
    "misfit": "look in the report how far the law misses the decay, and compare the laws",
    "position_errors": "map the sensor's errors of position",
    "ageing": "wait until the contact has settled, or state its history",
    "period_drift": "let the temperature settle before the next run",
}


class Limit(NamedTuple):
    """A source of the result's uncertainty, and its share of the variance."""

    name: str
    share: float


@dataclass(frozen=True, slots=True)
class DecayDrawn:
    """Amplitudes in arcsec and periods in s over time, each with what the exact fit makes of it."""

    time_s: Sequence[float]
    amplitude: Sequence[float]
    fitted: Sequence[float]
    period_time_s: Sequence[float]
    period_s: Sequence[float]
    fitted_period_s: Sequence[float]


@dataclass(frozen=True, slots=True)
class HandOver:
    """Of one session. `ended` is None while no run was made; `went` says in words how it stands.

    `headline` is the result with its uncertainty, `of` whether that is the whole budget or the swings alone;
    `limits` what makes the most of it, `next_steps` what to do. Empty where there are no results.
    """

    folder: Path
    ended: RunState | None
    went: str
    headline: str = ""
    of: str = ""
    limits: Sequence[Limit] = ()
    next_steps: Sequence[str] = ()
    others: Sequence[tuple[str, str]] = ()
    report: Path | None = None
    decay: DecayDrawn | None = None
    remarks: Sequence[str] = field(default_factory=tuple)


def state_of(session: SessionState) -> RunState | None:
    """How a session that does not run has ended: complete, stopped, failed, interrupted; None without a run.

    One that was killed is interrupted: a run of it is still noted as being recorded, or its next run did not
    begin.
    """
    if len(session.complete) >= session.runs_wanted:
        return RunState.COMPLETE
    if not session.entries:
        return None
    states = [entry.state for entry in session.entries]
    ended = RunState.RECORDING not in states and states[-1] in (RunState.STOPPED, RunState.FAILED)
    return states[-1] if ended else RunState.INTERRUPTED


def hand_over(folder: Path) -> HandOver:
    """What a session's folder holds; reads results, takes a moment.

    Raises RigError if there is no session in it.
    """
    session = read_session(folder)
    ended = state_of(session)
    reports = sorted(folder.glob("report*.html"), key=lambda path: path.stat().st_mtime)
    report = reports[-1] if reports else None
    went, steps = _went(session, ended), _steps_of_end(ended)
    if not results_path(folder).exists():
        if session.entries and report is None:
            steps = [*steps, "fit it again: there are no results yet (rig fit)"]
        return HandOver(folder, ended, went, next_steps=steps, report=report)
    try:
        results = read_results(folder)
    except RigError as error:
        return HandOver(folder, ended, went, next_steps=[*steps, str(error)], report=report)
    run = results.runs[-1]
    headline, of, limits = _headline(run, {} if results.series is None else results.series.budget)
    do = [_DO.get(one.name, f"know better: {_name(one)}") for one in limits if one.share >= _LIMITS_FROM]
    against = [f"{one.name}: {one.said}" for one in run.conditions if not one.ok or one.remedy]
    remarks = [*run.warnings, *against]
    if run.problem:
        headline, of = "", ""
        remarks.insert(0, f"no fit: {run.problem}")
    return HandOver(
        folder,
        ended,
        went,
        headline,
        of,
        [Limit(_name(one), one.share) for one in limits],
        [*steps, *do],
        _others(run),
        report,
        _decay(run),
        remarks,
    )


def _went(session: SessionState, ended: RunState | None) -> str:
    made = f"{len(session.complete)} of {session.runs_wanted} runs complete"
    reason = next((entry.reason for entry in reversed(session.entries) if entry.reason), "")
    return f"{made}; {reason}" if reason and ended is not None else made


def _steps_of_end(ended: RunState | None) -> list[str]:
    if ended is RunState.INTERRUPTED:
        return ["make the missing runs: Sessions, Resume"]
    return ["see why it failed, then start again"] if ended is RunState.FAILED else []


def _headline(run: RunResults, of_series: Mapping[str, Budget]) -> tuple[str, str, list[Limit]]:
    """The result that is looked for first, what its uncertainty is of, and what makes it, largest first."""
    if run.instrument is not None:
        return (run.instrument.text[0] if run.instrument.text else ""), "the swings", []
    exact, verdicts = run.fits.get(FitMethod.EXACT), run.verdicts()
    if exact is None:
        return "", "", []
    budget = of_series or run.budget
    for name in (_ENERGY, *DEFAULT_LAW.names(drag=False)):
        item = budget_of(name, budget, verdicts)
        if item is not None:
            shown = quantity(name)
            text = (
                f"{shown.symbol} = {shown.text(item.value, item.standard_uncertainty)} {shown.unit}".rstrip()
            )
            sources = sorted(item.sources, key=lambda line: -line.share)
            limits = [Limit(one.source, one.share) for one in sources if one.share >= _SHOWN_SHARE]
            return text, "the whole budget, swings and apparatus", limits
    name, found = next(iter(exact.parameters.items()), ("", Estimate(float("nan"), float("nan"))))
    if not name:
        return "", "", []
    shown = quantity(name)
    text = f"{shown.symbol} = {determined_text(name, found, verdicts)} {shown.unit}".rstrip()
    return text, "the swings alone", [Limit("swings", 1.0)]


def _name(limit: Limit) -> str:
    return SOURCES.get(limit.name, limit.name)


def _others(run: RunResults) -> list[tuple[str, str]]:
    exact, verdicts = run.fits.get(FitMethod.EXACT), run.verdicts()
    parameters = {} if exact is None else exact.parameters
    return [
        (quantity(name).label, determined_text(name, found, verdicts)) for name, found in parameters.items()
    ]


def _decay(run: RunResults) -> DecayDrawn | None:
    """The last run's decay; None where it was not fitted, or keeps no turning points."""
    if run.turning_points is None or not run.fits:
        return None
    points = run.turning_points.points()
    try:
        curves = curves_of(points, run) if len(points) >= 3 else None
    except DataError:
        return None
    if curves is None:
        return None
    first_s = points.time_s[0]
    return DecayDrawn(
        (points.time_s - first_s).tolist(),
        (points.amplitude / ARCSEC_RAD).tolist(),
        (curves.exact_rad / ARCSEC_RAD).tolist(),
        (curves.period_time_s - first_s).tolist(),
        curves.period_s.tolist(),
        curves.exact_period_s.tolist(),
    )
