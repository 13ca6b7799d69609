"""Goes on with a session that was interrupted: what is whole is kept, what was cut is repaired in a copy."""

from contextlib import closing, suppress
from pathlib import Path

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from processing.errors import RecordError
from rig.analysis import read_results, results_path
from rig.devices import Devices
from rig.measure.notices import Notices, announced
from rig.measure.session import Patience, make_runs, no_patience, report
from rig.measure.session_file import STATE_NAME, RunEntry, RunState, SessionFile
from rig.presentation import say
from rig.settings import Configuration, migrated, validate_configuration


def resume_session(folder: Path, *, force: bool = False, json_lines: bool = False) -> int:
    """Continue an interrupted session: complete runs are kept, the missing ones are made.

    A truncated record is left unchanged and a repaired copy is made next to it. New runs get new
    numbers. Returns the exit status like `measure_session`.
    """
    with closing(SessionFile.opened(folder)) as file:
        tree, note = migrated(file.state.configuration, f"{folder / STATE_NAME}: its configuration")
        if note:
            say(note)
        config = validate_configuration(tree, str(folder / STATE_NAME))
        with announced(config.session, folder) as told:
            told.status = go_on(file, config, told.notices, force=force, json_lines=json_lines)
    return told.status


def go_on(
    file: SessionFile,
    config: Configuration,
    notices: Notices,
    *,
    force: bool,
    json_lines: bool,
    patience: Patience = no_patience,
) -> int:
    """Make what is missing of a session, as `resume_session` says; `patience` as in `make_session`."""
    folder = file.folder
    for entry in file.state.entries:
        if entry.state is RunState.RECORDING:
            _close_interrupted(file, entry)
    for record in (folder / entry.record for entry in file.state.complete):
        if record.exists():
            _notice_cut(record)
    missing = file.state.runs_wanted - len(file.state.complete)
    say(f"{folder}: {len(file.state.complete)} of {file.state.runs_wanted} runs are complete")
    if missing <= 0 and _has_results(folder):
        say("no run is missing")
        return 0
    source = Path(file.state.source)
    with Devices(config, folder) as devices:
        made = make_runs(config, source, file, devices, notices, patience, force=force, json_lines=json_lines)
    return report(config, folder, made, json_lines=json_lines)


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
            end = end_of(reader.events())
            if end is not None and not reader.truncated:
                state = RunState.REJECTED if end.kind == EventKind.REJECTED else RunState.COMPLETE
                file.note(entry.number, entry.record, state, end.text)
                say(f"{entry.record} is whole: {end.text}")
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
    file.note(entry.number, entry.record, RunState.INTERRUPTED, reason, name)
