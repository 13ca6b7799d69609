"""Continues interrupted sessions, and measures lists of sessions one after the other."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from copy import deepcopy
from pathlib import Path

from acquisition.record import recovered_beside
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from processing.errors import ConfigurationError, RecordError
from rig.analysis import SessionResults, read_results, results_path
from rig.devices import Devices
from rig.instrument import check_materials, complete
from rig.measure.notices import PreflightWait, Sleep, announced, check_waiting
from rig.measure.posterior import check_stop_when
from rig.measure.run import ready_for_frames
from rig.measure.session import (
    SessionOptions,
    SessionOutcome,
    make_runs,
    measure_session,
    report,
    result_faults,
)
from rig.measure.session_file import STATE_NAME, RunEntry, RunState, SessionFile, end_noted, read_session
from rig.settings import (
    Configuration,
    apply_overrides,
    load_configuration,
    stored_configuration,
    unnumbered,
    validate_configuration,
)
from rig.terminal import say

_SEED_STEP_OF_SESSIONS = 2_000_003


def measure_sessions(
    sources: Sequence[Path],
    overrides: Sequence[str],
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    now_s: Callable[[], float] = time.monotonic,
    sleep: Sleep = time.sleep,
) -> int:
    """Measure one session for each configuration, in folders of their names in `output`.

    A session whose preflight still says no-go after `preflight.wait_max_s` is left out, and the next one
    begins. Any other failure, and Ctrl-C, end the list, so that nothing is lit again before a person has
    looked. Called again with the same folder, it continues the list. Returns the exit status: 0 if every
    session was measured under its conditions. Raises ConfigurationError before anything is lit if one of the
    configurations cannot be used.
    """
    names = [source.stem for source in sources]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ConfigurationError(f"{twice}: named twice; each session needs a folder of its own name")
    configs = [
        _numbered_configuration(_checked(source, overrides), place) for place, source in enumerate(sources)
    ]
    folder = output or configs[0].session.output
    worst = 0
    for source, config in zip(sources, configs, strict=True):
        place = folder / source.stem
        waiting = PreflightWait(source.stem, config.preflight, now_s, sleep)
        say(f"session {place}")
        if (place / STATE_NAME).exists():
            status = _continue_session(place, config, waiting, force=force, json_lines=json_lines)
        else:
            status = measure_session(
                config, source, place, force=force, json_lines=json_lines, waiting=waiting
            )
        worst = max(worst, status)
        if (why := _why_ended(place)) and not waiting.over:
            say(f"session {place}: {why}; the list ends here", error=True)
            return 1
    return worst


def _why_ended(folder: Path) -> str:
    """Why the last run of a session failed or was stopped; empty if it did neither."""
    if not (folder / STATE_NAME).exists():
        return "nothing was recorded"
    last = read_session(folder).entries[-1]
    return last.reason if last.state in {RunState.FAILED, RunState.STOPPED} else ""


def _checked(source: Path, overrides: Sequence[str]) -> Configuration:
    """The complete configuration of a file; raises ConfigurationError if it cannot be used."""
    config = complete(load_configuration(source, overrides))
    check_materials(config)
    check_stop_when(config)
    check_waiting(config)
    return config


def _numbered_configuration(config: Configuration, place: int) -> Configuration:
    """The configuration of the session at `place` in a list; simulated ones get their own random numbers."""
    if not config.simulated or place == 0:
        return config
    seed = (config.simulation.seed + _SEED_STEP_OF_SESSIONS * place) % 2**63
    return config.model_copy(update={"simulation": config.simulation.model_copy(update={"seed": seed})})


def _continue_session(
    folder: Path, config: Configuration, waiting: PreflightWait, *, force: bool, json_lines: bool
) -> int:
    with announced(config.session, folder) as outcome, closing(SessionFile.opened(folder)) as file:
        outcome.status = _make(file, config, SessionOptions(outcome.notices, force, json_lines, waiting))
    return outcome.status


def resume_session(
    folder: Path,
    instead: Path | None = None,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
    json_lines: bool = False,
) -> int:
    """Continue an interrupted session: complete runs stay, the missing runs are made.

    The missing runs get the configuration with which the session was begun, or that of the file `instead`,
    either with `overrides`; from then on it is the configuration of the session. A truncated record is left
    unchanged and a recovered copy is made next to it. New runs get new numbers. Returns the exit status like
    `measure_session`.
    """
    with closing(SessionFile.opened(folder)) as file:
        source = instead or Path(file.state.source)
        if instead is None:
            tree = unnumbered(deepcopy(file.state.configuration), f"{folder / STATE_NAME}: its configuration")
            apply_overrides(tree, overrides)
            config = validate_configuration(tree, str(folder / STATE_NAME), overrides)
            config = config.remember_file(source, overrides)
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
            waiting = PreflightWait(folder.name, config.preflight)
            outcome.status = _make(file, config, SessionOptions(outcome.notices, force, json_lines, waiting))
    return outcome.status


def _make(file: SessionFile, config: Configuration, options: SessionOptions) -> int:
    """Make the missing runs of a session and fit them, as described in `resume_session`."""
    folder = file.folder
    for entry in file.state.entries:
        if entry.state is RunState.RECORDING:
            _close_interrupted(file, entry)
    for record in (folder / entry.record for entry in file.state.complete):
        if record.exists():
            _report_truncated(record)
    missing = file.state.runs_wanted - len(file.state.complete)
    say(f"{folder}: {len(file.state.complete)} of {file.state.runs_wanted} runs are complete")
    if missing <= 0:
        say("no run is missing")
        if (results := _whole_results(file)) is None:
            # complete records are fitted without the rig, which may not even exist any more
            records = [folder / entry.record for entry in file.state.complete]
            return report(config, folder, SessionOutcome(records, failed=False, stopped=False), options)
        faults = result_faults(results, config)
        for why in faults:
            say(why)
        options.notices.failures.extend(faults)
        return 1 if faults else 0
    with (
        ready_for_frames(live=not config.on_demand),
        Devices(config, folder, "rig run --resume") as devices,
    ):
        outcome = make_runs(config, Path(file.state.source), file, devices, options)
    return report(config, folder, outcome, options)


def _whole_results(file: SessionFile) -> SessionResults | None:
    """The results if they can be read and contain every complete run, else None; makes a missing report."""
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


def _report_truncated(record: Path) -> None:
    """Report a record that was complete at the end of its run but is truncated now, e.g. by a failed copy."""
    with RecordReader(record) as reader:
        if reader.truncated:
            say(reader.cut_notice)


def _close_interrupted(file: SessionFile, entry: RunEntry) -> None:
    """Save how a run that was being recorded has ended; make a recovered copy of a truncated record."""
    record = file.folder / entry.record
    if end_text := end_noted(file, entry):
        say(end_text)
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
