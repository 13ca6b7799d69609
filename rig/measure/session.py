"""A session: records one or more runs of one contact pair, then fits each of them."""

import datetime
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from acquisition.record.events import EventKind
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from processing.errors import ConfigurationError, DeviceError, RecordError, RigError
from rig.analysis import (
    AnalysedRun,
    analyse_record,
    free_path,
    print_results,
    read_results,
    results_path,
    session_results,
    write_results,
)
from rig.devices import Devices
from rig.instrument import check_materials, complete
from rig.interruption import Terminated, reason_of
from rig.measure.notices import Notices, announced
from rig.measure.recording import NOT_ACCEPTED
from rig.measure.run_setup import RunPlan, measure_run
from rig.measure.session_file import STATE_NAME, RunEntry, RunState, SessionFile
from rig.presentation import failures, print_json_line, say
from rig.settings import Configuration, validate_configuration


def measure_session(
    config: Configuration,
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
) -> int:
    """Measure `session.runs` runs, fit each from its closed record, and write results.json.

    `force` continues after a failed preflight. With `json_lines` stdout gets one JSON object per
    line instead of a table. Returns the exit status: 0 if every run ended regularly and was fitted,
    else 1. Raises ConfigurationError for an output folder that already contains a run.
    """
    config = complete(config)
    check_materials(config)
    folder = session_folder(config, source, output)
    with announced(config.session, folder) as told, ExitStack() as closing:
        with Devices(config, folder) as devices:
            file = SessionFile.made(folder, source, config.session.runs, config.model_dump(mode="json"))
            closing.callback(file.close)
            made = _make_runs(config, source, file, devices, told.notices, force=force, json_lines=json_lines)
        told.status = _report(config, folder, made, json_lines=json_lines)
        return told.status


def resume_session(folder: Path, *, force: bool = False, json_lines: bool = False) -> int:
    """Continue an interrupted session: complete runs are kept, the missing ones are made.

    A truncated record is left unchanged and a repaired copy is made next to it. New runs get new
    numbers. Returns the exit status like `measure_session`.
    """
    file = SessionFile.opened(folder)
    try:
        config = validate_configuration(file.state.configuration, str(folder / STATE_NAME))
        for entry in file.state.entries:
            if entry.state == "recording":
                _close_interrupted(file, entry)
        for record in (folder / entry.record for entry in file.state.complete):
            if record.exists():
                _notice_cut(record)
        missing = file.state.runs_wanted - len(file.state.complete)
        say(f"{folder}: {len(file.state.complete)} of {file.state.runs_wanted} runs are complete")
        if missing <= 0 and _has_results(folder):
            say("no run is missing")
            return 0
        with announced(config.session, folder) as told:
            with Devices(config, folder) as devices:
                source = Path(file.state.source)
                made = _make_runs(
                    config, source, file, devices, told.notices, force=force, json_lines=json_lines
                )
            told.status = _report(config, folder, made, json_lines=json_lines)
            return told.status
    finally:
        file.close()


def _has_results(folder: Path) -> bool:
    """Whether there are whole results; a report that is missing beside them is made."""
    from rig.report import make_report

    path = results_path(folder)
    try:
        read_results(path)
    except RecordError as error:
        say(str(error))
        return False
    if not path.with_name(path.name.replace("results", "report", 1)).with_suffix(".html").exists():
        say(f"report {make_report(path)}")
    return True


def _notice_cut(record: Path) -> None:
    """Report a record that was complete at the end of its run but is truncated now, e.g. by a failed copy."""
    with RecordReader(record) as reader:
        if reader.truncated:
            say(reader.cut_notice)


def _close_interrupted(file: SessionFile, entry: RunEntry) -> None:
    """Note a record that came to its end as complete; make a repaired copy of one that was cut short."""
    record = file.folder / entry.record
    if record.exists():
        with suppress(RecordError), RecordReader(record) as reader:
            stops = [event.text for event in reader.events() if event.kind == EventKind.STOP]
            if stops and not reader.truncated:
                state: RunState = "rejected" if stops[-1].startswith(NOT_ACCEPTED) else "complete"
                file.note(entry.number, entry.record, state, stops[-1])
                say(f"{entry.record} is whole: {stops[-1]}")
                return
    whole = record.with_name(f"{record.stem}-recovered{record.suffix}")
    name, reason = "", "the session was interrupted"
    if record.exists():
        try:
            if not whole.exists():
                recover(record, whole)
            name = whole.name
            say(f"{entry.record} was cut short and stays as it is; {whole.name} is a whole copy")
        except RecordError as error:
            reason = f"{reason}; {error}"
    file.note(entry.number, entry.record, "interrupted", reason, name)


class _Made(NamedTuple):
    """The records made, and how the session ended."""

    records: list[Path]
    failed: bool
    stopped: bool


def _make_runs(
    config: Configuration,
    source: Path,
    file: SessionFile,
    devices: Devices,
    notices: Notices,
    *,
    force: bool,
    json_lines: bool,
) -> _Made:
    """Make the missing runs. Raises `Terminated` after everything is closed and session.json is written."""
    folder = file.folder
    records = [folder / entry.record for entry in file.state.complete]
    failed = stopped = False
    while len(records) < file.state.runs_wanted and not (failed or stopped):
        number = file.state.next_number
        record = folder / f"run-{number}.mcap"
        file.note(number, record.name, "recording")

        def start_rejected(path: Path, reason: str, number: int = number) -> None:
            file.note(number, path.name, "rejected", reason)
            say(f"run {number}: {NOT_ACCEPTED}: {reason}")

        plan = RunPlan(
            _numbered(config, number),
            source,
            record,
            f"run {number}",
            force,
            json_lines,
            start_rejected,
            [notices],
        )
        try:
            acknowledge_interlock(devices)
            outcome = measure_run(plan, devices)
        except (RigError, OSError) as error:
            file.note(number, record.name, "failed", str(error))
            if not records:
                raise
            say(f"run {number} failed: {error}", error=True)
            failed = True
            break
        if outcome.hangs:
            # the entry stays as it is: only when nothing writes any more can the record be repaired
            raise DeviceError(
                f"{outcome.hangs}: the laser is dark, {record} stays as it is; "
                f"remove the cause (a disk that hangs?), then rig run --resume {folder}"
            )
        reason = outcome.snapshot.reason
        interrupt = outcome.interrupt
        stopped = interrupt is not None and reason == reason_of(interrupt)
        state: RunState = "failed" if outcome.failure is not None else "stopped" if stopped else "complete"
        file.note(number, record.name, state, str(outcome.failure or reason))
        if outcome.failure is not None:
            failed = True
            say(f"run {number} failed: {outcome.failure}", error=True)
        if record.exists():
            records.append(record)
        else:
            failed = True
        if isinstance(interrupt, Terminated):
            say(f"{reason}; rig run --resume {folder} goes on, rig fit fits what there is")
            raise interrupt
    return _Made(records, failed, stopped)


def acknowledge_interlock(devices: Devices) -> None:
    """After an interlock has opened, ask whether light is allowed again; raises DeviceError without a yes."""
    opened = devices.permit.unacknowledged
    if not opened:
        return
    if sys.stdin.isatty() and sys.stderr.isatty():
        answer = input(f"{opened}. Look that nobody is in the beam's way. Light the laser again? [y/N] ")
        if answer.strip().lower() in {"y", "yes"}:
            devices.acknowledge()
            return
    raise DeviceError(f"{opened} and nobody has allowed light again; rig run --resume makes the missing runs")


def _report(config: Configuration, folder: Path, made: _Made, *, json_lines: bool) -> int:
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
    # without a calibration nothing can be fitted, which does not count as a failure
    failed = failed or (any(run.results.problem for run in runs) and config.lever is not None)
    failed = failed or any(failures(run.results.conditions) for run in runs)
    path = free_path(folder)
    results = session_results(runs, folder)
    write_results(path, results)
    paths = _paths(folder, runs, path)
    try:
        paths.append(("report", make_report(path)))
    except RigError as error:
        # records and results are complete, so a missing report is not fatal
        say(f"no report: {error}", error=True)
    if json_lines:
        print_json_line("results", {"path": str(path), "failed": failed})
    else:
        print_results(results, paths)
        if config.simulated and config.simulation.ground.model == "none":
            say(
                "the simulated foundation stood still, so uncertainties are smaller than on a real one; "
                "configs/basement.toml is the same rig in an ordinary basement"
            )
    return 1 if failed else 0


def simulate_record(config: Configuration, source: Path, record: Path) -> int:
    """Record one run of the simulated rig, without viewer and fits; returns the exit status."""
    if not config.simulated:
        raise ConfigurationError(
            f"camera.driver = {config.camera.driver!r}: rig simulate needs the simulated camera; "
            "use rig run for a real one"
        )
    quiet = config.view.model_copy(update={"mode": "none", "file": False})
    record.parent.mkdir(parents=True, exist_ok=True)
    config = complete(config.model_copy(update={"view": quiet}))
    with Devices(config) as devices:
        outcome = measure_run(RunPlan(config, source, record, "simulation"), devices)
    if outcome.failure is not None:
        say(f"simulation failed: {outcome.failure}", error=True)
        return 1
    if outcome.interrupt is not None:
        raise outcome.interrupt
    print(record)
    return 0


def session_folder(config: Configuration, source: Path, output: Path | None) -> Path:
    """Create the folder of this session; raises ConfigurationError if it already contains a run."""
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
    if folder.is_dir() and (list(folder.glob("run-*.mcap")) or (folder / "results.json").exists()):
        raise ConfigurationError(f"{folder}: holds a run already, which is never overwritten; name another")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder


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
        paths.append(("record", run.record))
        paths += [("Rerun file", rrd) for rrd in sorted(folder.glob(f"{run.record.stem}*.rrd"))]
    return [*paths, ("results", path)]
