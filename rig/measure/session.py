"""Measures a session: records one or more runs of one contact pair, then fits each of them."""

import datetime
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError, DeviceError, RecordError, RigError
from rig.analysis import (
    RESULTS_NAME,
    SessionResults,
    analyse_record,
    free_path,
    print_results,
    read_results,
    results_path,
    session_results,
    write_results,
)
from rig.devices import Devices, OrderSocket, SessionNews, safety_values
from rig.instrument import check_materials, complete
from rig.interruption import Terminated, reason_of
from rig.measure.notices import Notices, PreflightWait, check_notices, check_waiting
from rig.measure.phases import NoGo
from rig.measure.posterior import check_stop_when
from rig.measure.run import measure_run
from rig.measure.run_parts import RunPlan, ready_for_frames
from rig.measure.session_file import (
    STATE_NAME,
    RunState,
    SessionFile,
    close_earlier_runs,
    note_recorded_end,
    withdraw_unrecorded,
)
from rig.measure.session_orders import Notes, await_acknowledgement, orders
from rig.settings import (
    Configuration,
    apply_overrides,
    load_configuration,
    stored_configuration,
    validate_configuration,
    without_schema,
)
from rig.terminal import failures, print_json_line, say

_SEED_STEP_OF_RUNS = 1_000_003


def measure_session(
    config: Configuration,
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    waiting: PreflightWait | None = None,
) -> int:
    """Measure `session.runs` runs, fit each from its closed record, and write results.json.

    `force` continues after a failed preflight. With `json_lines` stdout gets one JSON object per line instead
    of a table. `waiting` waits after a no-go of the preflight; by default as the configuration states.
    Returns the exit status: 0 if every run ended regularly and was fitted, else 1. Raises ConfigurationError
    for an output folder that already contains a run.
    """
    config = complete_checked(config)
    if output is not None:
        withdraw_unrecorded(output)
    folder, created = session_folder(config, source, output)
    try:
        stored = stored_configuration(config)
        with closing(SessionFile.create(folder, source, config.session.runs, stored)) as file:
            return finish_session(file, config, "rig run", waiting, force=force, json_lines=json_lines)
    finally:
        withdraw_unrecorded(folder, created)


def resume_session(
    folder: Path,
    replacement: Path | None = None,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
    json_lines: bool = False,
) -> int:
    """Continue an interrupted session: complete runs stay, the missing runs are made.

    The missing runs get the configuration with which the session was begun, or that of the file
    `replacement`, either with `overrides`; from then on it is the configuration of the session. A truncated
    record is left unchanged and a recovered copy is made next to it. New runs get new numbers. Returns the
    exit status like `measure_session`.
    """
    with closing(SessionFile.opened(folder)) as file:
        source = replacement or Path(file.state.source)
        if replacement is None:
            tree = without_schema(
                deepcopy(file.state.configuration), f"{folder / STATE_NAME}: its configuration"
            )
            apply_overrides(tree, overrides)
            config = validate_configuration(tree, str(folder / STATE_NAME), overrides)
            config = config.remember_file(source, overrides)
        else:
            config = load_configuration(replacement, overrides)
        if replacement is None and not overrides:
            say(f"{folder}: continues as begun, with {source} (--set changes it, --config takes another)")
        else:
            config = complete_checked(config)
            changes = file.reconfigure(source, stored_configuration(config))
            if any(override.partition("=")[0].strip() == "session.runs" for override in overrides):
                file.save(file.state.model_copy(update={"runs_wanted": config.session.runs}))
            say(f"{folder}: continues with {source}, which states {changes}")
        return finish_session(file, config, "rig run --resume", force=force, json_lines=json_lines)


def complete_checked(config: Configuration) -> Configuration:
    """The complete configuration of a session; raises ConfigurationError if it cannot be used."""
    config = complete(config)
    check_materials(config)
    check_stop_when(config)
    check_waiting(config)
    check_notices(config)
    return config


class SessionOptions(NamedTuple):
    """Options of the runs of a session."""

    notices: Notices
    """Sends alarms, and collects causes of failure."""
    force: bool
    """Whether runs are made in spite of a failed preflight."""
    json_lines: bool
    """Whether stdout gets JSON lines instead of a table."""
    waiting: PreflightWait
    """Waits after a no-go, while the laser is dark."""


def finish_session(
    file: SessionFile,
    config: Configuration,
    task: str,
    waiting: PreflightWait | None = None,
    *,
    force: bool,
    json_lines: bool,
) -> int:
    """Make the missing runs of a new or a resumed session, fit them, and send a notice of its end.

    Returns the exit status like `measure_session`.
    """
    folder, results, failed = file.folder, None, False
    waiting = waiting or PreflightWait(folder.name, config.preflight)
    with Notices(config.session, folder) as notices:
        options = SessionOptions(notices, force, json_lines, waiting)
        if file.state.entries:
            close_earlier_runs(file)
        if len(file.state.complete) >= file.state.runs_wanted:
            # complete records are fitted without the rig, which may not even exist any more
            say("no run is missing")
            results, records = _whole_results(file), file.complete_records
        else:
            with ready_for_frames(live=not config.on_demand), Devices(config, folder, task) as devices:
                records, failed = make_runs(config, file, devices, options)
        if results is None:
            status = report(config, folder, records, options, failed=failed)
        else:
            faults = result_faults(results, config)
            for why in faults:
                say(why)
            notices.failures.extend(faults)
            status = 1 if faults else 0
        notices.tell_end(status)
        return status


@contextmanager
def _interrupts_noted(file: SessionFile) -> Iterator[None]:
    """Notes how a run has ended that an interrupt ends, and says after a signal how to continue."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        reason = reason_of(interrupt)
        for entry in file.state.entries:
            if entry.state is RunState.RECORDING:
                # a record states by itself how its run ended; this interrupt came before the record
                if not (file.folder / entry.record).exists():
                    file.note(entry.number, entry.record, RunState.STOPPED, reason)
                note_recorded_end(file, entry)
        if isinstance(interrupt, Terminated):
            remedy = f"rig run --resume {file.folder} continues, rig fit fits the runs so far"
            # an OSError comes from a terminal that was closed
            with suppress(OSError):
                say(f"{reason}; {remedy if _has_record(file) else 'nothing was recorded'}")
        raise


def make_runs(
    config: Configuration, file: SessionFile, devices: Devices, options: SessionOptions
) -> tuple[list[Path], bool]:
    """Make the missing runs of a session; returns its complete and new records, and whether a run failed.

    Meanwhile its order socket serves its state and takes orders. Raises `Terminated` after everything is
    closed and session.json is written.
    """
    folder, session_news = file.folder, SessionNews()
    notes = Notes(folder, config.session.operator)
    by_name = orders(devices, notes, session_news)
    socket = OrderSocket(folder, session_news, by_name, lambda: safety_values(devices))
    with socket, _interrupts_noted(file):
        if socket.problem:
            say(socket.problem)
        records = file.complete_records
        failed = stopped = False

        def say_failed(number: int, error: Exception) -> None:
            say(f"run {number} failed: {error}", error=True)
            options.notices.failures.append(f"run {number} failed: {error}")

        while len(records) < file.state.runs_wanted and not (failed or stopped):
            number = file.state.next_number
            record = folder / f"run-{number}.mcap"
            file.note(number, record.name, RunState.RECORDING)

            def start_rejected(path: Path, reason: str, number: int = number) -> None:
                file.note(number, path.name, RunState.REJECTED, reason)

            plan = RunPlan(
                with_other_seed(config, _SEED_STEP_OF_RUNS * (number - 1)),
                Path(file.state.source),
                record,
                f"run {number}",
                options.force,
                options.json_lines,
                is_last=len(records) + 1 >= file.state.runs_wanted,
                start_rejected=start_rejected,
                watchers=[options.notices],
                session_news=session_news,
                take_notes=notes.take,
            )
            try:
                devices.lights_again = True
                await_acknowledgement(devices, session_news, resumable=_has_record(file))
                outcome = measure_run(plan, devices)
            except (RigError, OSError) as error:
                file.note(number, record.name, RunState.FAILED, str(error))
                if not records:
                    raise
                say_failed(number, error)
                failed = True
                break
            if outcome.hangs:
                # the entry stays: the record can be repaired only when no thread writes to it any more
                laser = "" if config.laser.kind == "none" else "the laser was ordered off, "
                raise DeviceError(
                    f"{outcome.hangs}: {laser}{record} stays as it is; "
                    f"remove the cause (a disk that hangs?), then rig run --resume {folder}"
                )
            if isinstance(outcome.failure, NoGo) and outcome.interrupt is None:
                devices.darken("preflight said no-go")
                file.forget(record.name)
                session_news.waits(f"no-go: {outcome.failure.failed_checks}")
                # a person who asks for light during the wait gets it with the next try
                devices.lights_again = True
                if options.waiting(outcome.failure.failed_checks):
                    continue
                devices.lights_again = False
            options.waiting.first_no_go = ""
            reason, interrupt, stopped = outcome.last.reason, outcome.interrupt, outcome.stopped
            state = RunState.FAILED if outcome.failure is not None else RunState.COMPLETE
            # also if the user has ended the run before its record began
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
                raise interrupt
        return records, failed


def _has_record(file: SessionFile) -> bool:
    """Whether the session has a record; a session without one is withdrawn when it ends."""
    return any((file.folder / entry.record).exists() for entry in file.state.entries)


def report(
    config: Configuration,
    folder: Path,
    records: Sequence[Path],
    options: SessionOptions,
    *,
    failed: bool,
) -> int:
    """Fit records and write the results; returns the exit status, 1 also after a run that `failed`."""
    # importing matplotlib takes a second, which must not delay the first frame
    from rig.report import make_report

    runs = [analyse_record(record) for record in records]
    if not runs:
        return 1
    path = free_path(folder)
    results = session_results(runs, folder)
    faults = result_faults(results, config)
    failed = failed or bool(faults)
    options.notices.failures.extend(faults)
    write_results(path, results)
    paths = [("record", run.path) for run in runs]
    paths.append(("results", path))
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


def result_faults(results: SessionResults, config: Configuration) -> list[str]:
    """Faults of runs, each with the name of its record: no fit, or conditions that were not met."""
    faults = []
    for run in results.runs:
        # a run without a calibrated lever cannot be fitted, which is not a failure
        problem = run.problem if config.lever is not None else ""
        faults += [f"{run.record}: {why}" for why in (problem, failures(run.conditions)) if why]
    return faults


def _whole_results(file: SessionFile) -> SessionResults | None:
    """The results, and their report is made if it is missing; None unless they contain every complete run."""
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
        # the program was ended before it fitted the last runs
        return None
    if not path.with_name(path.name.replace("results", "report", 1)).with_suffix(".html").exists():
        say(f"report {make_report(path)}")
    return results


def session_folder(config: Configuration, source: Path, output: Path | None) -> tuple[Path, list[Path]]:
    """Make the folder of a session; returns it, and all folders that were created, the innermost first.

    Raises ConfigurationError if the folder already contains a run.
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
    if folder.is_dir() and (any(folder.glob("run-*.mcap")) or (folder / RESULTS_NAME).exists()):
        raise ConfigurationError(f"{folder}: holds a run already, which is never overwritten; name another")
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder, created


def with_other_seed(config: Configuration, more: int) -> Configuration:
    """The configuration with a seed larger by `more`: each simulated run gets its own random numbers."""
    if not config.simulated or not more:
        return config
    simulation = config.simulation
    seed = (simulation.seed + more) % 2**63
    return config.model_copy(update={"simulation": simulation.model_copy(update={"seed": seed})})
