"""A session: records one or more runs of one contact pair, then fits each of them."""

import datetime
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError, DeviceError, RigError
from rig.analysis import (
    AnalysedRun,
    SessionResults,
    analyse_record,
    free_path,
    print_results,
    session_results,
    write_results,
)
from rig.devices import Devices, OrderSocket, SessionNews, devices_now
from rig.instrument import check_materials, complete
from rig.measure.notices import Notices, Waiting, announced, check_waiting
from rig.measure.phases import NoGo
from rig.measure.posterior import check_stop_when
from rig.measure.run import measure_run, ready_for_frames
from rig.measure.run_parts import RunPlan
from rig.measure.session_file import RunState, SessionFile, end_noted, withdraw_unrecorded
from rig.measure.session_orders import Notes, await_leave, orders
from rig.presentation import answer, failures, print_json_line, say
from rig.settings import Configuration, stored_configuration
from rig.terminal import Terminated, reason_of


def measure_session(
    config: Configuration,
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    waiting: Waiting | None = None,
) -> int:
    """Measure `session.runs` runs, fit each from its closed record, and write results.json.

    `force` continues after a failed preflight. With `json_lines` stdout gets one JSON object per
    line instead of a table. After a no-go of the preflight it waits as `waiting` says, by default as the
    configuration states. Returns the exit status: 0 if every run ended regularly and was fitted,
    else 1. Raises ConfigurationError for an output folder that already contains a run.
    """
    config = complete(config)
    check_materials(config)
    check_stop_when(config)
    check_waiting(config)
    if output is not None:
        withdraw_unrecorded(output)
    folder, made = session_folder(config, source, output)
    try:
        with announced(config.session, folder) as outcome:
            waiting = waiting or Waiting(folder.name, config.preflight)
            options = SessionOptions(outcome.notices, force, json_lines, waiting)
            outcome.status = _make_session(config, source, folder, options)
    finally:
        withdraw_unrecorded(folder, made)
    return outcome.status


class SessionOptions(NamedTuple):
    """How runs are made: who gets notices, whether a failed preflight is passed over, what stdout gets.

    `waiting` is asked, with the reason, after a preflight that said no-go: if it returns True the run is
    tried again. The laser is dark meanwhile.
    """

    notices: Notices
    force: bool
    json_lines: bool
    waiting: Waiting


def _make_session(config: Configuration, source: Path, folder: Path, options: SessionOptions) -> int:
    """As `measure_session`, with a complete configuration and in a folder that was made for it."""
    with ExitStack() as closing:
        with ready_for_frames(live=not config.on_demand), Devices(config, folder, "rig run") as devices:
            file = SessionFile.made(folder, source, config.session.runs, stored_configuration(config))
            closing.callback(file.close)
            made = make_runs(config, source, file, devices, options)
        return report(config, folder, made, options)


class SessionOutcome(NamedTuple):
    """The records made, and how the session ended."""

    records: list[Path]
    failed: bool
    stopped: bool


def make_runs(
    config: Configuration, source: Path, file: SessionFile, devices: Devices, options: SessionOptions
) -> SessionOutcome:
    """Make the missing runs. Raises `Terminated` after everything is closed and session.json is written.

    Meanwhile the session can be watched, and takes orders, through its order socket.
    """
    session_news, notes = SessionNews(), Notes(file.folder, config.session.operator)
    with OrderSocket(
        file.folder, session_news, orders(devices, notes), lambda: devices_now(devices)
    ) as watched:
        if watched.problem:
            say(watched.problem)
        try:
            return _make_runs(config, source, file, devices, options, session_news, notes)
        except KeyboardInterrupt:
            # it may come between the end of a run and the note of it
            for entry in file.state.entries:
                if entry.state is RunState.RECORDING:
                    end_noted(file, entry)
            raise


def _make_runs(
    config: Configuration,
    source: Path,
    file: SessionFile,
    devices: Devices,
    options: SessionOptions,
    session_news: SessionNews,
    notes: Notes,
) -> SessionOutcome:
    folder = file.folder
    records = [folder / entry.record for entry in file.state.complete]
    failed = stopped = False

    def say_failed(number: int, error: Exception) -> None:
        say(f"run {number} failed: {error}", error=True)
        options.notices.against.append(f"run {number} failed: {error}")

    while len(records) < file.state.runs_wanted and not (failed or stopped):
        number = file.state.next_number
        record = folder / f"run-{number}.mcap"
        file.note(number, record.name, RunState.RECORDING)

        def start_rejected(path: Path, reason: str, number: int = number) -> None:
            file.note(number, path.name, RunState.REJECTED, reason)

        plan = RunPlan(
            _numbered(config, number),
            source,
            record,
            f"run {number}",
            options.force,
            options.json_lines,
            is_last=len(records) + 1 >= file.state.runs_wanted,
            start_rejected=start_rejected,
            watchers=[options.notices],
            session_news=session_news,
            notes=notes,
            waited=options.waiting.said(),
        )
        try:
            devices.lights_again = True
            await_leave(devices, session_news, resumable=_has_record(file))
            outcome = measure_run(plan, devices)
        except (RigError, OSError) as error:
            file.note(number, record.name, RunState.FAILED, str(error))
            if not records:
                raise
            say_failed(number, error)
            failed = True
            break
        except KeyboardInterrupt as interrupted:
            # before it was recorded; what has a record says by itself how it ended
            if not record.exists():
                file.note(number, record.name, RunState.STOPPED, reason_of(interrupted))
            if isinstance(interrupted, Terminated):
                _say_how_to_go_on(reason_of(interrupted), file)
            raise
        if outcome.hangs:
            # the entry stays as it is: only when nothing writes any more can the record be repaired
            off = "" if config.laser.kind == "none" else "the laser was told off, "
            raise DeviceError(
                f"{outcome.hangs}: {off}{record} stays as it is; "
                f"remove the cause (a disk that hangs?), then rig run --resume {folder}"
            )
        if isinstance(outcome.failure, NoGo) and outcome.interrupt is None:
            devices.darken("preflight said no-go")
            file.forget(record.name)
            session_news.waits(f"no-go: {outcome.failure.against}")
            # who asks for light while it waits gets it with the next try
            devices.lights_again = True
            if options.waiting(outcome.failure.against):
                continue
            devices.lights_again = False
        reason, interrupt, stopped = outcome.last.reason, outcome.interrupt, outcome.stopped
        state = RunState.FAILED if outcome.failure is not None else RunState.COMPLETE
        # also where the user has ended it before it began
        if stopped and (outcome.failure is None or not record.exists()):
            state = RunState.STOPPED
        file.note(number, record.name, state, str(outcome.failure or reason))
        if outcome.failure is not None:
            failed = True
            say_failed(number, outcome.failure)
        if record.exists():
            records.append(record)
        else:
            failed = True
        if isinstance(interrupt, Terminated):
            _say_how_to_go_on(reason, file)
            raise interrupt
    return SessionOutcome(records, failed, stopped)


def _say_how_to_go_on(reason: str, file: SessionFile) -> None:
    """After the program was told to end; without a record nothing is left of the session to go on with."""
    remedy = f"rig run --resume {file.folder} continues, rig fit fits the runs so far"
    # a terminal that was closed hears nothing
    with suppress(OSError):
        say(f"{reason}; {remedy if _has_record(file) else 'nothing was recorded'}")


def _has_record(file: SessionFile) -> bool:
    """Whether the session has a record, without which it is withdrawn when it ends."""
    return any((file.folder / entry.record).exists() for entry in file.state.entries)


def report(config: Configuration, folder: Path, made: SessionOutcome, options: SessionOptions) -> int:
    """Fit the complete and the new records and write the results; the laser is already off."""
    # importing matplotlib takes a second, which must not delay the first frame
    from rig.report import make_report

    records, failed = made.records, made.failed
    if made.stopped and records and not _wants_fit():
        say(f"record {records[-1]}; rig fit {records[-1]} fits it later")
        records = records[:-1]
    runs = [analyse_record(record) for record in records]
    if not runs:
        return 1
    path = free_path(folder)
    results = session_results(runs, folder)
    against = against_results(results, config)
    failed = failed or bool(against)
    options.notices.against.extend(against)
    write_results(path, results)
    paths = _paths(folder, runs, path)
    try:
        paths.append(("report", make_report(path)))
    except RigError as error:
        # records and results are complete, so a missing report is not fatal
        say(f"no report: {error}", error=True)
    if options.json_lines:
        print_json_line("results", {"path": str(path), "failed": failed})
    else:
        print_results(results, paths)
        if config.simulated and config.simulation.ground.model == "none":
            say(
                "the simulated foundation stood still, so uncertainties are smaller than on a real one; "
                "rig init --example basement writes the same rig in an ordinary basement"
            )
    return 1 if failed else 0


def against_results(results: SessionResults, config: Configuration) -> list[str]:
    """What speaks against runs, each with the name of its record: no fit, conditions that were not met."""
    found = []
    for run in results.runs:
        # without a calibration nothing can be fitted, which does not count as a failure
        problem = run.problem if config.lever is not None else ""
        found += [f"{run.record}: {why}" for why in (problem, failures(run.conditions)) if why]
    return found


def simulate_record(config: Configuration, source: Path, record: Path) -> int:
    """Record one run of the simulated rig, without viewer and fits; returns the exit status."""
    if not config.simulated:
        raise ConfigurationError(
            f"camera.driver = {config.camera.driver!r}: --record-only needs the simulated camera; "
            "rig camera record records a real one"
        )
    quiet = config.view.model_copy(update={"mode": "none", "file": False})
    record.parent.mkdir(parents=True, exist_ok=True)
    config = complete(config.model_copy(update={"view": quiet}))
    with ready_for_frames(live=not config.on_demand), Devices(config, task="rig run") as devices:
        outcome = measure_run(
            RunPlan(config, source, record, "simulation", fitted=bool(config.session.stop_when)), devices
        )
    if outcome.failure is not None:
        say(f"simulation failed: {outcome.failure}", error=True)
        return 1
    if outcome.interrupt is not None:
        raise outcome.interrupt
    answer(written=[record])
    print(record)
    return 0


def session_folder(config: Configuration, source: Path, output: Path | None) -> tuple[Path, list[Path]]:
    """Make the folder of this session; returns it, and the folders that were made, the innermost first.

    Raises ConfigurationError if it already contains a run.
    """
    if output is None:
        now = datetime.datetime.now().astimezone()
        name = f"{now:%Y-%m-%dT%H-%M-%S}-{source.stem}"
        folder = config.session.output / name
        number = 2
        while folder.exists():
            folder = config.session.output / f"{name}-{number}"
            number += 1
    else:
        folder = output
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; name a folder for the session")
    if folder.is_dir() and (any(folder.glob("run-*.mcap")) or (folder / "results.json").exists()):
        raise ConfigurationError(f"{folder}: holds a run already, which is never overwritten; name another")
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder, made


def _numbered(config: Configuration, number: int) -> Configuration:
    """The configuration of run `number`; each simulated run gets its own random numbers."""
    if not config.simulated or number == 1:
        return config
    seed = (config.simulation.seed + 1_000_003 * (number - 1)) % 2**63
    return config.model_copy(update={"simulation": config.simulation.model_copy(update={"seed": seed})})


def _wants_fit() -> bool:
    """After Ctrl-C ask whether to fit the record; without a terminal it is fitted."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return True
    try:
        answer = input("The record is closed. Fit it now? [Y/n] ")
    except (EOFError, KeyboardInterrupt):
        return False
    return answer.strip().lower() in {"", "y", "yes"}


def _paths(folder: Path, runs: list[AnalysedRun], path: Path) -> list[tuple[str, Path]]:
    paths = []
    for run in runs:
        paths.append(("record", run.path))
        paths += [("Rerun file", rrd) for rrd in sorted(folder.glob(f"{run.path.stem}*.rrd"))]
    return [*paths, ("results", path)]
