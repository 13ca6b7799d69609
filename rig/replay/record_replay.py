"""The command `rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from acquisition.record.events import Event
from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from rig.analysis import (
    RESULTS_NAME,
    AnalysedRun,
    analyse_record,
    analyse_run,
    print_results,
    recorded_results,
    session_results,
    write_results,
)
from rig.instrument import configuration_attachments, recorded_configuration
from rig.presentation import Keys, answer, print_line, say
from rig.replay.comparison import parameter_changes
from rig.replay.player import HELP, MOST_FRAMES, Player
from rig.replay.replay import Replay, Replayed
from rig.replay.screen import ReplayLine, print_changes, print_comparison
from rig.settings import Configuration, Watched
from rig.terminal import Terminated
from rig.view import Mode, ScratchHead, ScratchView

_LOOK_S = 0.2


def _events(reader: RecordReader) -> list[Event]:
    """Events and notes in order of time."""
    return sorted([*reader.events(), *(note.event for note in reader.notes())], key=lambda one: one.time_ns)


def speed_of(text: str) -> float:
    """Speed from a positive number or ``max`` (infinite); raises ConfigurationError for anything else."""
    try:
        speed = math.inf if text == "max" else float(text)
    except ValueError:
        speed = math.nan
    if not speed > 0:
        raise ConfigurationError(f"--speed {text}: must be a number above 0, or max")
    return speed


def replay_record(
    record: Path,
    output: Path | None,
    *,
    retrack: bool,
    overrides: Sequence[str],
    speed: str = "max",
    from_s: float = 0.0,
    to_s: float = math.inf,
    mode: Mode = "none",
    rrd: Path | None = None,
) -> int:
    """Replay, compare and fit; writes results.json into `output` if given. Returns the exit status.

    Raises ConfigurationError for an invalid speed or invalid times, and RecordError for a file that
    cannot be replayed, before anything is written; RecordError at the end where the Rerun file is not whole.
    """
    pace = speed_of(speed)
    if not 0 <= from_s < to_s:
        raise ConfigurationError(
            f"--from {from_s:g} --to {to_s:g}: the part must begin before it ends, from 0 on"
        )
    with RecordReader(record) as reader:
        remedy = "frames stay as they were recorded" if retrack else "what the tracker takes needs --retrack"
        watched = Watched(recorded_configuration(reader, overrides), overrides, remedy)
        config = watched.config
        if reader.truncated:
            say(reader.cut_notice)
        wants_view = mode != "none" or rrd is not None
        replay = Replay(reader, config, retrack=retrack, from_s=from_s, to_s=to_s, pictures=wants_view)
        with ExitStack() as stack:
            view = None
            if wants_view:
                name = f"replay of {record.stem}"
                view = stack.enter_context(ScratchView(name, mode, rrd, "measuring", math.inf))
                attachments = {**reader.attachments, **configuration_attachments(config, Path())}
                metadata = {name: texts for name, texts in reader.metadata.items() if name != "record"}
                view.begin(replay.start_ns, ScratchHead(metadata, attachments, config.deflection_unit))
            keys = stack.enter_context(Keys())
            line = stack.enter_context(ReplayLine(config.deflection_unit.shown, HELP if keys.there else ""))
            player = Player(
                replay,
                pace,
                keys,
                line,
                retrack=retrack,
                view=view,
                events=_events(reader) if wants_view else [],
            )
            player.play()
            result = player.finish()
            if mode == "web" and not player.ended_by_user:
                say("the page has all of it and stays until q or Ctrl-C; the results follow then")
                _stay(keys)
        partial = replay.partial or replay.sought or player.ended_by_user
        run = replace(_analysed(reader, config, result), watched=watched)
        if partial:
            part = f"replayed from {replay.begun_s:.2f} s to {replay.position_s:.2f} s of the record"
            # the record's end is not that of the part
            found = replace(run.results, ended=None, warnings=(part, *run.results.warnings))
            run = replace(run, results=found)
    results = session_results([run], output or record.parent)
    _say_differences(record, replay, result, run, partial=partial, retracked=retrack)
    print_results(results, [])
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_results(output / RESULTS_NAME, results)
        answer(written=[output / RESULTS_NAME])
        print(f"results      {output / RESULTS_NAME}")
    if rrd is not None:
        answer(written=[rrd])
        print(f"Rerun file   {rrd}")
    return 1 if run.results.problem and config.lever is not None and not partial else 0


def _stay(keys: Keys) -> None:
    """Wait for the key q, or Ctrl-C, which end no more than the page."""
    try:
        while "q" not in keys.pressed(_LOOK_S):
            pass
    except Terminated:
        raise
    except KeyboardInterrupt:
        pass


def analyse_replayed(record: Path, *, retrack: bool, overrides: Sequence[str] = ()) -> AnalysedRun:
    """Fit the half-cycles found again in the recorded spots, or with `retrack` in the recorded pixels.

    Nothing is shown or written. Raises RecordError for a record that cannot be replayed.
    """
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, overrides)
        replay = Replay(reader, config, retrack=retrack)
        while replay.advance(math.inf, MOST_FRAMES[retrack]) is not None:
            pass
        return _analysed(reader, config, replay.finish())


def _analysed(reader: RecordReader, config: Configuration, result: Replayed) -> AnalysedRun:
    return analyse_run(
        reader,
        config,
        result.swings,
        result.deflections,
        config.deflection_unit,
        result.beam,
        lambda _: result.dropped_frames,
    )


def _say_differences(
    record: Path, replay: Replay, result: Replayed, run: AnalysedRun, *, partial: bool, retracked: bool
) -> None:
    """Print differences from the recorded spots, half-cycles and fitted parameters."""
    if replay.sought:
        print_line(
            f"restarted at {replay.begun_s:.2f} s by going back: "
            "the results are not compared with the recorded ones"
        )
        return
    answer(comparison=result.comparison)
    print_comparison(result.comparison, partial=partial, retracked=retracked)
    if partial:
        return
    source, known = recorded_results(record, run.results.sha256)
    if known is None and not result.comparison.identical:
        source, known = "fitted", analyse_record(record).results
    if known is not None:
        changes = parameter_changes(known, run.results)
        answer(changes=changes)
        print_changes(changes, source)
