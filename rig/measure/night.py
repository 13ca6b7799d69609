"""An unattended night: the series of a plan one after the other, each when its conditions allow."""

import datetime
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

from acquisition.record import recovered_beside
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from processing.errors import ConfigurationError, RecordError
from rig.analysis import SessionResults, read_results, results_path
from rig.devices import Devices
from rig.instrument import check_materials, complete
from rig.measure.notices import announced
from rig.measure.run import ready_for_frames
from rig.measure.session import (
    SessionOptions,
    SessionOutcome,
    against_results,
    make_runs,
    make_session,
    report,
    session_folder,
)
from rig.measure.session_file import STATE_NAME, RunEntry, RunState, SessionFile, end_noted, read_session
from rig.posterior import check_stop_when
from rig.presentation import failures, say
from rig.settings import (
    Configuration,
    PlannedSeries,
    apply_overrides,
    load_configuration,
    load_plan,
    stored_configuration,
    unnumbered,
    validate_configuration,
)

_SEED_STEP = 2_000_003
Sleep = Callable[[float], None]
_LONG_ENOUGH_S = 60.0
"""Look at rest that holds the eight periods which the ground's drive needs."""


def check_conditions(asked: PlannedSeries, config: Configuration) -> None:
    """Raise ConfigurationError for conditions that a configuration cannot see."""
    who, source = f"series {asked.name}", asked.config
    if asked.asks_the_air and config.environment_sensor.kind == "none":
        what = "temperature_c needs a thermometer"
        if asked.humidity_percent is not None:
            what = "humidity_percent needs a sensor of the air"
        raise ConfigurationError(f"{who}: {what}: see [environment_sensor] in {source}")
    if asked.asks_the_rest and (config.start.way == "at once" or config.lever is None):
        what = "quiet_arcsec" if asked.quiet_arcsec is not None else "ground_rad_per_s2_rthz"
        raise ConfigurationError(
            f"{who}: {what} needs a pendulum at rest and [lever]:"
            f" set start.way to 'by hand', 'magnet' or 'starter' in {source}"
        )
    if asked.ground_rad_per_s2_rthz is not None and config.preflight.duration_s < _LONG_ENOUGH_S:
        raise ConfigurationError(
            f"{who}: ground_rad_per_s2_rthz needs eight periods at rest: set preflight.duration_s to "
            f"{_LONG_ENOUGH_S:g} or more, it is {config.preflight.duration_s:g} in {source}"
        )


class Waiting:
    """Waits until a run may be tried again; `over` once it must not any more."""

    def __init__(self, asked: PlannedSeries, now_s: Callable[[], float], sleep: Sleep) -> None:
        self._who, self._now_s, self._sleep = f"series {asked.name}", now_s, sleep
        self._every_s, self._longest_s = asked.try_every_s, asked.wait_max_s
        self._waited_s = self._this_s = 0.0
        self._since = self._last = ""
        self._refused = False
        self.over = False

    def __call__(self, why: str) -> bool:
        """Whether to try again, after a time, what was refused for this reason."""
        left_s = self._longest_s - self._waited_s
        if not self._since:
            self._since = f"{datetime.datetime.now().astimezone():%H:%M}"
        if left_s <= 0:
            self.over = True
            say(f"{self._who} is left out: not ready within {self._longest_s:g} s: {why}", error=True)
            return False
        self._last, self._refused = why, True
        say(f"{self._who}: waiting since {self._since}: {why}")
        begun_s = self._now_s()
        self._sleep(min(self._every_s, left_s))
        lasted_s = self._now_s() - begun_s
        self._waited_s += lasted_s
        self._this_s += lasted_s
        return True

    def said(self) -> list[str]:
        """What the run that is tried now has waited for; asked at every try."""
        if not self._refused:
            # the run before was made
            self._since, self._this_s = "", 0.0
        self._refused = False
        if not self._since:
            return []
        return [f"waited from {self._since} for {self._this_s / 60:.0f} min: {self._last}"]


def measure_plan(
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    now_s: Callable[[], float] = time.monotonic,
    sleep: Sleep = time.sleep,
) -> int:
    """Measure the series of a plan in folders of their names, in `output` or where the first one belongs.

    A run whose preflight says no-go is tried again until the series has waited `wait_max_s`; then the series
    is left out and the next one begins. Anything else that fails, and Ctrl-C, ends the plan: nothing is lit
    again before somebody has looked. When a plan is started again, series are continued where they ended.
    Returns the exit status: 0 if every series was measured under its conditions. Raises ConfigurationError
    before anything is lit if a configuration of the plan cannot be used.
    """
    plan = load_plan(source)
    configs = [_of_place(_configuration(series), place) for place, series in enumerate(plan.series)]
    folder = output or configs[0].session.output / source.stem
    worst = 0
    for series, config in zip(plan.series, configs, strict=True):
        place = folder / series.name
        waiting = Waiting(series, now_s, sleep)
        say(f"series {series.name}")
        end = _measure_series(series, config, place, waiting, force=force, json_lines=json_lines)
        worst = max(worst, end.status)
        if end.failure and not waiting.over:
            say(f"series {series.name}: {end.failure}; the plan ends here", error=True)
            return 1
        if series is not plan.series[-1] and end.made:
            sleep(series.pause_s)
    return worst


def _of_place(config: Configuration, place: int) -> Configuration:
    """The simulated rig has other random numbers in each series, as in each run of one."""
    if not config.simulated or place == 0:
        return config
    seed = (config.simulation.seed + _SEED_STEP * place) % 2**63
    return config.model_copy(update={"simulation": config.simulation.model_copy(update={"seed": seed})})


class _SeriesEnd(NamedTuple):
    """How a series ended: its exit status, why its last run failed or was stopped, if it was, and whether any
    was made.
    """

    status: int
    failure: str
    made: bool


def _measure_series(
    series: PlannedSeries,
    config: Configuration,
    folder: Path,
    waiting: Waiting,
    *,
    force: bool,
    json_lines: bool,
) -> _SeriesEnd:
    """Make the runs of a series that are missing in its folder, and repeat its bad ones."""
    before = read_session(folder).next_number if (folder / STATE_NAME).exists() else 0
    with announced(config.session, folder) as outcome:
        options = SessionOptions(outcome.notices, force, json_lines, waiting, waiting.said)
        outcome.status = _Series(series, config, folder, options).made_and_repeated()
    with closing(SessionFile.opened(folder)) as file:
        last, made = file.state.entries[-1], file.state.next_number != before
    bad = last.state in {RunState.FAILED, RunState.STOPPED}
    return _SeriesEnd(outcome.status, last.reason if bad else "", made)


def _configuration(series: PlannedSeries) -> Configuration:
    """Raises ConfigurationError where it cannot be used, or cannot see the conditions of its runs."""
    config = complete(load_configuration(series.config, series.overrides()))
    check_materials(config)
    check_stop_when(config)
    check_conditions(series, config)
    return config


class _Series(NamedTuple):
    """What measuring a series takes."""

    planned: PlannedSeries
    config: Configuration
    folder: Path
    options: SessionOptions

    def made_and_repeated(self) -> int:
        """Measure it and repeat its bad runs; returns its exit status."""
        status = self._gone_on() if (self.folder / STATE_NAME).exists() else self._made()
        repeats = self.planned.repeat_bad - _repeated(self.folder)
        while status and (bad := _set_bad_aside(self.folder, repeats)):
            repeats -= bad
            say(f"series {self.planned.name}: {bad} of its runs are repeated; their conditions were not met")
            status = self._gone_on()
        return status

    def _made(self) -> int:
        source = self.planned.config
        folder, _ = session_folder(self.config, source, self.folder)
        return make_session(self.config, source, folder, self.options)

    def _gone_on(self) -> int:
        with closing(SessionFile.opened(self.folder)) as file:
            return _go_on(file, self.config, self.options)


def _repeated(folder: Path) -> int:
    """How many runs were set aside; a rejected start has a record of another name."""
    return sum(
        entry.state is RunState.REJECTED and entry.record == f"run-{entry.number}.mcap"
        for entry in read_session(folder).entries
    )


def _set_bad_aside(folder: Path, most: int) -> int:
    """Note runs whose conditions were not met as rejected, so that others are made; returns how many.

    None if a run failed, or if not all are there.
    """
    with closing(SessionFile.opened(folder)) as file:
        if len(file.state.complete) < file.state.runs_wanted:
            return 0
        try:
            judged = {run.record: failures(run.conditions) for run in read_results(folder).runs}
        except RecordError:
            return 0
        bad = [entry for entry in file.state.complete if judged.get(entry.record)][: max(most, 0)]
        for entry in bad:
            file.note(entry.number, entry.record, RunState.REJECTED, judged[entry.record])
    return len(bad)


def resume_session(
    folder: Path,
    instead: Path | None = None,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
    json_lines: bool = False,
) -> int:
    """Continue an interrupted session: complete runs are kept, the missing ones are made.

    They get the configuration with which the session was begun, or that of the file `instead`, either with
    `overrides`; it is then the session's. A
    truncated record is left unchanged and a recovered copy is made next to it. New runs get new numbers.
    Returns the exit status like `measure_session`.
    """
    with closing(SessionFile.opened(folder)) as file:
        source = instead or Path(file.state.source)
        if instead is None:
            tree = unnumbered(deepcopy(file.state.configuration), f"{folder / STATE_NAME}: its configuration")
            apply_overrides(tree, overrides)
            config = validate_configuration(tree, str(folder / STATE_NAME), overrides)
            config = config.from_file(source, overrides)
        else:
            config = load_configuration(instead, overrides)
        if instead is None and not overrides:
            say(f"{folder}: continues as begun, with {source} (--set changes it, --config takes another)")
        else:
            config = complete(config)
            check_materials(config)
            check_stop_when(config)
            changed = file.reconfigure(source, stored_configuration(config))
            if any(text.partition("=")[0].strip() == "session.runs" for text in overrides):
                file.save(file.state.model_copy(update={"runs_wanted": config.session.runs}))
            say(f"{folder}: continues with {source}, which states {changed}")
        with announced(config.session, folder, file) as outcome:
            outcome.status = _go_on(file, config, SessionOptions(outcome.notices, force, json_lines))
    return outcome.status


def _go_on(file: SessionFile, config: Configuration, options: SessionOptions) -> int:
    """Make what is missing of a session, as `resume_session` says."""
    folder = file.folder
    for entry in file.state.entries:
        if entry.state is RunState.RECORDING:
            _close_interrupted(file, entry)
    for record in (folder / entry.record for entry in file.state.complete):
        if record.exists():
            _notice_cut(record)
    missing = file.state.runs_wanted - len(file.state.complete)
    say(f"{folder}: {len(file.state.complete)} of {file.state.runs_wanted} runs are complete")
    if missing <= 0:
        say("no run is missing")
        if (results := _whole_results(file)) is None:
            # what is recorded is fitted without the rig, which may not even be there any more
            records = [folder / entry.record for entry in file.state.complete]
            return report(config, folder, SessionOutcome(records, failed=False, stopped=False), options)
        against = against_results(results, config)
        for why in against:
            say(why)
        options.notices.against.extend(against)
        return 1 if against else 0
    with (
        ready_for_frames(live=not config.on_demand),
        Devices(config, folder, "rig run --resume") as devices,
    ):
        made = make_runs(config, Path(file.state.source), file, devices, options)
    return report(config, folder, made, options)


def _whole_results(file: SessionFile) -> SessionResults | None:
    """The results, where they are whole and have every complete run; a report that is missing is made."""
    from rig.report import make_report

    path = results_path(file.folder)
    if not path.exists():
        say("there are no results yet, they are made now")
        return None
    try:
        results = read_results(path)
    except RecordError as error:
        say(str(error))
        return None
    if {entry.record for entry in file.state.complete} - {run.record for run in results.runs}:
        # the program was ended before it fitted what it had made
        return None
    if not path.with_name(path.name.replace("results", "report", 1)).with_suffix(".html").exists():
        say(f"report {make_report(path)}")
    return results


def _notice_cut(record: Path) -> None:
    """Report a record that was complete at the end of its run but is truncated now, e.g. by a failed copy."""
    with RecordReader(record) as reader:
        if reader.truncated:
            say(reader.cut_notice)


def _close_interrupted(file: SessionFile, entry: RunEntry) -> None:
    """Note how a record ended that has an end; make a recovered copy of one that was cut off."""
    record = file.folder / entry.record
    if said := end_noted(file, entry):
        say(said)
        return
    name, reason = "", "the session was interrupted"
    if record.exists():
        try:
            whole = recovered_beside(record)
            if not whole.exists():
                recover(record, whole)
            name = whole.name
            say(f"{entry.record} was cut short and stays as it is; {whole.name} is a whole copy")
        except RecordError as error:
            reason = f"{reason}; {error}"
    file.note(entry.number, entry.record, RunState.INTERRUPTED, reason, name)
