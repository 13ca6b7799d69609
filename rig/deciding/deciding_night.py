"""A night that decides: measures the run that brings its targets nearest, learns from it, chooses again."""

import datetime
import time
from collections.abc import Callable
from pathlib import Path

from processing.campaign import Choice
from processing.errors import ConfigurationError, DataError
from rig.campaigns import (
    AskedPlan,
    FoundRun,
    NamedRuns,
    PlannedCampaign,
    PlannedKind,
    Planner,
    changes_of,
    kinds_text,
    reasons,
    runs_of_folders,
)
from rig.deciding.decisions import ChosenState, Decision, DecisionsFile, Ending
from rig.measure import Sleep, Waiting, measure_series, series_configuration
from rig.presentation import print_json_line, say
from rig.settings import Configuration, DecidingPlan, PlannedSeries, load_deciding_plan

_SEED_STEP = 1_000_003
_IN_VAIN = 3
"""Runs one after the other that tell nothing, after which nothing is expected of a further one."""


def _utc_now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def decide_night(
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    now_s: Callable[[], float] = time.monotonic,
    now_utc: Callable[[], datetime.datetime] = _utc_now,
    sleep: Sleep = time.sleep,
) -> int:
    """Measure the runs that reach the targets of a plan soonest, until they are reached or cannot be.

    Each run is a series of a night with a folder of its own: light, preflight, conditions and faults are
    those of `measure_plan`. The same command goes on with a night that was ended, with all that was learned.
    Returns the exit status: 0 if the targets are reached. Raises ConfigurationError before anything is lit if
    the plan cannot be used, or needs a person who is not said to be there.
    """
    plan = load_deciding_plan(source)
    config = series_configuration(_series(plan, "night", plan.set))
    _check_starts(plan, config)
    planner = Planner(_asked(plan))
    folder = output or config.session.output / source.stem
    folder.mkdir(parents=True, exist_ok=True)
    file = DecisionsFile(folder, now_utc(), plan.model_dump(mode="json", by_alias=True))
    if file.goes_on:
        changed = f"; the plan was changed: {'; '.join(file.changed)}" if file.changed else ""
        say(f"{folder}: continues after {len(file.now.measured)} runs{changed}")
    night = _Night(plan, config, planner, folder, file, now_s, now_utc, sleep)
    while True:
        decision = file.now.pending or night.decide()
        if decision is None:
            break
        say(f"run {decision.number}: {decision.why}")
        if json_lines:
            print_json_line("decision", decision.model_dump(mode="json"))
        failure = night.measure(decision, force=force, json_lines=json_lines)
        if failure:
            say(f"run {decision.number}: {failure}; the night ends here", error=True)
            return 1
    say(f"the night ends: {file.now.said}")
    return 0 if file.now.ending is Ending.REACHED else 1


class _Night:
    """What a night knows, and what it does next."""

    def __init__(
        self,
        plan: DecidingPlan,
        config: Configuration,
        planner: Planner,
        folder: Path,
        file: DecisionsFile,
        now_s: Callable[[], float],
        now_utc: Callable[[], datetime.datetime],
        sleep: Sleep,
    ) -> None:
        self._plan, self._config, self._planner = plan, config, planner
        self._folder, self._file = folder, file
        self._now_s, self._now_utc, self._sleep = now_s, now_utc, sleep
        # the time of the day may be set back meanwhile: the night is no longer for it
        self._began_s = now_s()
        self._before_s = max((now_utc() - file.now.begun_utc).total_seconds(), 0.0)

    def decide(self) -> Decision | None:
        """The run to be made now; None, and in the file why, where none is."""
        now, plan = self._file.now, self._plan
        made = now.decisions
        if len(made) >= plan.max_runs:
            return self._ended(Ending.LIMIT, f"max_runs = {plan.max_runs} were made", self._last_choice())
        vain = [one.state is ChosenState.FAILED for one in made[-_IN_VAIN:]]
        if len(vain) == _IN_VAIN and all(vain):
            return self._ended(Ending.CANNOT, f"{_IN_VAIN} uninformative runs in a row")
        left_s = self._left_s()
        try:
            planned = self._planner.plan(
                self._found(), longest_s=max(left_s, 0.0), most_runs=plan.max_runs - len(made), learns=True
            )
        except DataError as error:
            return self._ended(Ending.CANNOT, str(error))
        choice = planned.choice
        if choice.now < 1:
            return self._ended(Ending.REACHED, reasons(planned)[-1], choice)
        if choice.floor >= 1:
            return self._ended(Ending.CANNOT, reasons(planned)[-1], choice)
        if not choice.runs:
            end = f"{self._ends_utc().astimezone():%H:%M}"
            return self._ended(Ending.LIMIT, f"no run ends before {end}, when the night does", choice)
        return self._chosen(planned)

    def measure(self, decision: Decision, *, force: bool, json_lines: bool) -> str:
        """Make a run and take its results; returns why nothing may be lit after it, or nothing."""
        name = f"run {decision.number}"
        self._rest(decision)
        series = _series(self._plan, decision.folder, self._changes(decision))
        waiting = Waiting(
            self._plan,
            name,
            self._now_s,
            self._sleep,
            longest_s=max(self._left_s() - decision.rig_time_s, 0.0),
            told=lambda text: self._file.save(waiting=text),
        )
        end = measure_series(
            series,
            series_configuration(series),
            self._folder / decision.folder,
            waiting,
            lambda: [decision.why, *waiting.said()],
            force=force,
            json_lines=json_lines,
        )
        state, said = ChosenState.MEASURED, ""
        if end.failure:
            state, said = ChosenState.FAILED, end.failure
        else:
            try:
                self._runs(decision)
            except (ConfigurationError, DataError, OSError) as error:
                state, said = ChosenState.FAILED, str(error)
        self._file.note(decision.model_copy(update={"state": state, "said": said}))
        if waiting.over:
            self._ended(Ending.CONDITIONS, said)
        return end.failure

    def _chosen(self, planned: PlannedCampaign) -> Decision:
        choice, number = planned.choice, len(self._file.now.decisions) + 1
        first = choice.runs[0]
        kind = planned.kind(first.candidate)
        decision = Decision(
            number=number,
            folder=f"{number:02d}-{kind.first_arcsec:g}-to-{kind.last_arcsec:g}",
            first_arcsec=kind.first_arcsec,
            last_arcsec=kind.last_arcsec,
            sample=kind.sample,
            waiting_s=kind.waiting_s,
            rig_time_s=first.candidate.rig_time_s,
            chosen_utc=self._now_utc(),
            after_runs=planned.made,
            u_before=first.before,
            u_expected=first.after,
            why=_why(planned),
        )
        self._file.save(u_now=choice.now)
        self._file.note(decision)
        return decision

    def _rest(self, decision: Decision) -> None:
        """Wait, in the dark, as the run was chosen to."""
        left_s = decision.waiting_s - (self._now_utc() - decision.chosen_utc).total_seconds()
        left_s = min(left_s, decision.waiting_s)
        if left_s > 0:
            text = f"the contact rests for {left_s / 60:.0f} min before run {decision.number}"
            say(text)
            self._file.save(waiting=text)
            self._sleep(left_s)

    def _changes(self, decision: Decision) -> tuple[str, ...]:
        config = self._config
        kind = PlannedKind(decision.first_arcsec, decision.last_arcsec, decision.waiting_s, decision.sample)
        changes = changes_of(kind, config, self._plan.set)
        longest_s = min(config.session.max_duration_s, max(self._left_s(), decision.rig_time_s))
        stated = {"session.max_duration_s": f"{longest_s:.0f}"}
        if config.simulated:
            # each has random numbers of its own
            seed = (config.simulation.seed + _SEED_STEP * (decision.number - 1)) % 2**63
            stated["simulation.seed"] = f"{seed}"
        kept = [change for change in changes if change.partition("=")[0].strip() not in stated]
        return (*kept, *(f"{key}={value}" for key, value in stated.items()))

    def _found(self) -> list[FoundRun]:
        """All runs of which something is known: those before the night, and its own."""
        plan = self._plan
        before = NamedRuns(plan.after, plan.archive, plan.where).of_one_sample()
        return [*before, *(run for one in self._file.now.measured for run in self._runs(one))]

    def _runs(self, decision: Decision) -> list[FoundRun]:
        return runs_of_folders([self._folder / decision.folder])

    def _ends_utc(self) -> datetime.datetime:
        return self._plan.ends_utc(self._file.now.begun_utc)

    def _left_s(self) -> float:
        """Time until the night ends."""
        begun = self._file.now.begun_utc
        elapsed_s = max(
            (self._now_utc() - begun).total_seconds(), self._before_s + self._now_s() - self._began_s
        )
        if self._config.on_demand:
            # what is simulated is measured sooner than it lasts
            elapsed_s = max(elapsed_s, self._file.now.rig_time_s)
        return (self._ends_utc() - begun).total_seconds() - elapsed_s

    def _last_choice(self) -> Choice | None:
        """What the last run has brought, where no other one may be made."""
        try:
            return self._planner.plan(self._found(), longest_s=0.0, most_runs=0).choice
        except DataError:
            return None

    def _ended(self, ending: Ending, said: str, choice: Choice | None = None) -> Decision | None:
        """No further run is chosen."""
        if choice is not None and ending is Ending.LIMIT:
            if choice.now < 1:
                ending = Ending.REACHED
            said += f"; u is {choice.now:.3g} of its limit"
        now = {} if choice is None else {"u_now": choice.now}
        self._file.save(ending=ending, said=said, waiting="", **now)
        return None


def _series(plan: DecidingPlan, name: str, changes: tuple[str, ...]) -> PlannedSeries:
    """One run as a series of a night, under the plan's conditions."""
    return PlannedSeries(
        name=name,
        config=plan.config,
        runs=1,
        set=changes,
        temperature_c=plan.temperature_c,
        humidity_percent=plan.humidity_percent,
        quiet_arcsec=plan.quiet_arcsec,
        ground_rad_per_s2_rthz=plan.ground_rad_per_s2_rthz,
        wait_max_s=plan.wait_max_s,
        try_every_s=plan.try_every_s,
    )


def _asked(plan: DecidingPlan) -> AskedPlan:
    return AskedPlan(
        source=plan.config,
        targets=plan.targets,
        first_arcsec=plan.first_arcsec,
        last_arcsec=plan.last_arcsec,
        overrides=plan.set,
        noise_arcsec=plan.noise_arcsec,
        contact=plan.contact,
        waits_min=plan.waits_min,
        campaign=plan.campaign,
    )


def _check_starts(plan: DecidingPlan, config: Configuration) -> None:
    """Refuse what cannot be started without a person, unless one is said to be there."""
    way, several = config.start.way, len(plan.first_arcsec) > 1
    if way == "by hand" and not plan.attended:
        raise ConfigurationError(
            f"start.way = 'by hand' in {plan.config}: nobody releases the pendulum at night; use a magnet or "
            "a starter (start.way), or state attended = true in the plan if a person is there"
        )
    if way == "at once" and not config.simulated:
        raise ConfigurationError(
            f"start.way = 'at once' in {plan.config}: nothing sets the pendulum swinging: set "
            "'magnet' or 'starter', or 'by hand' with attended = true in the plan"
        )
    if way == "magnet" and several:
        named = ", ".join(f"{one:g}" for one in plan.first_arcsec)
        raise ConfigurationError(
            f"first_arcsec = [{named}]: the magnet releases from one place (start.way = 'magnet' in "
            f"{plan.config}); state one, or use a starter"
        )


def _why(planned: PlannedCampaign) -> str:
    """Why the first of the chosen runs is made now."""
    choice = planned.choice
    first = choice.runs[0]
    before = f"{planned.made} runs" if planned.made else "the priors alone"
    hours = choice.rig_time_s / 3600
    which = f"{len(choice.runs)} runs ({kinds_text(choice)})"
    best = ", ".join(f"{label} {gain:.2g}" for label, gain in choice.gains[:3])
    reach = (
        f"{which} reach it soonest, in {hours:.1f} h"
        if choice.reached
        else f"within the plan's limits it is not reached: {which} bring it to {choice.expected:.2f}"
    )
    several = len({one.candidate.label for one in choice.runs}) > 1
    place = ", by chance the first of them," if several else ""
    return (
        f"{first.candidate.label}: after {before} u is {first.before:.3g} of its limit; {reach}; this one"
        f"{place} should leave {first.after:.3g}; largest gain per time, as ln u per hour: {best}"
    )
