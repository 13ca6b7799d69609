"""`rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

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
from rig.interruption import Terminated
from rig.settings import Configuration, KeyUseMonitor
from rig.terminal import (
    Keys,
    QuantityDisplay,
    Table,
    TableRow,
    answer,
    plain,
    print_line,
    print_tables,
    quantity,
    say,
    signed,
)
from rig.view.replay import Replay, ReplayResult
from rig.view.replay_comparison import Differences, ParameterDifference, ReplayDifferences, parameter_changes
from rig.view.replay_player import HELP, MAX_FRAMES, Player, ReplayLine
from rig.view.scratch import Mode, ScratchView

_MAX_ROUNDING_U = 0.01
"""Largest change, in standard uncertainties, that is attributed to rounding."""
_KEY_INTERVAL_S = 0.2
_EXACT, _ASYMPTOTIC = "fits.exact.", "fits.asymptotic."


def print_comparison(comparison: ReplayDifferences, *, partial: bool, retracked: bool = False) -> None:
    """Print one line if nothing differs, else a short table of spots and half-cycles."""
    spots, half_cycles = comparison.spots, comparison.half_cycles
    if comparison.identical:
        flagged = comparison.flagged
        flagged_text = f" ({flagged} flagged and not fitted)" if flagged else ""
        print_line(
            f"{comparison.frames} spots and {half_cycles.replayed} half-cycles{flagged_text}, "
            "equal bit for bit to the recorded ones"
        )
        return
    rows = [
        [name, *map(str, differences[:3]), _largest(differences, place)]
        for name, differences, place in (
            ("spots", spots, f"frame {spots.largest_at:.0f}"),
            ("half-cycles", half_cycles, f"{half_cycles.largest_at:.1f} s"),
        )
    ]
    head = ("", "recorded", "replayed", "changed", "largest change")
    print_tables([Table("comparison", "", head, head, [TableRow(row, row) for row in rows])])
    if retracked and not spots.once and 0 < spots.largest_u < _MAX_ROUNDING_U:
        # each fit starts at the spot of the previous frame, which passes rounding errors on
        print_line(
            "the spots agree: pixels of a window are counted from another corner than those of the whole "
            "frame, so that sums are rounded differently"
        )
    if partial:
        say(
            "half-cycles of a part differ in any case: they are numbered from its beginning, "
            "and the pipeline adapts to the frames before"
        )


def print_changes(changes: Sequence[ParameterDifference], source: str) -> None:
    """Print the changes of the recorded fitted parameters; one line if nothing changed.

    The exact fit of the contact law is shown with values and changes, the asymptotic fit with changes only.
    """
    if not changes:
        return
    if all(change.change_u == 0.0 for change in changes):
        text = f"{len(changes)} fitted numbers, equal to those of {source}"
        print_line(text)
        return
    by_name = {change.name: change for change in changes}
    asymptotic = [change for name, change in by_name.items() if name.startswith(_ASYMPTOTIC)]
    head = ("", f"{source}, u: swings", "change / u", *(["of the asymptotic fit"] if asymptotic else []))
    rows: list[list[str]] = []
    for name, change in by_name.items():
        if name.startswith(_ASYMPTOTIC):
            continue
        asymptotic_fit = by_name.get(name.replace(_EXACT, _ASYMPTOTIC))
        parameter = name.removeprefix(_EXACT)
        shown = quantity(parameter) if parameter != name else QuantityDisplay(name, "", name)
        asymptotic_change = [_in_u(asymptotic_fit) if asymptotic_fit else ""] if asymptotic else []
        rows.append([shown.label, shown.text(*change.recorded), _in_u(change), *asymptotic_change])
    print_tables([Table("changes", "", head, head, [TableRow(row, row) for row in rows])])


def _in_u(change: ParameterDifference) -> str:
    return "?" if math.isnan(change.change_u) else signed(change.change_u)


def _largest(differences: Differences, place: str) -> str:
    """The largest change of those present in both, and the number of those present in only one, in words."""
    texts = [f"{plain(differences.largest_u, 2)} u, {place}"] if differences.largest_u > 0 else []
    texts += [f"{differences.once} in one of the two only"] if differences.once else []
    return "; ".join(texts or ["only in uncertainties or flags"]) if differences.changed else ""


def _events(reader: RecordReader) -> list[Event]:
    """Events and notes in order of time."""
    notes = (note.event for note in reader.notes())
    return sorted([*reader.events(), *notes], key=lambda event: event.time_ns)


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
    """Replay, compare and fit a record; writes results.json into `output` if given. Returns the exit status.

    Raises ConfigurationError for an invalid speed or invalid times, and RecordError for a file that cannot be
    replayed, before anything is written; RecordError at the end if the Rerun file is not whole.
    """
    speed_factor = speed_of(speed)
    if not 0 <= from_s < to_s:
        raise ConfigurationError(
            f"--from {from_s:g} --to {to_s:g}: the part must begin before it ends, from 0 on"
        )
    with RecordReader(record) as reader:
        remedy = "frames stay as they were recorded" if retrack else "what the tracker takes needs --retrack"
        key_monitor = KeyUseMonitor(recorded_configuration(reader, overrides), overrides, remedy)
        config = key_monitor.config
        if reader.truncated:
            say(reader.cut_notice)
        wants_view = mode != "none" or rrd is not None
        replay = Replay(reader, config, retrack=retrack, from_s=from_s, to_s=to_s, pictures=wants_view)
        with ExitStack() as stack:
            view = None
            if wants_view:
                name = f"replay of {record.stem}"
                unit = config.deflection_unit
                view = stack.enter_context(ScratchView(name, mode, rrd, "measuring", unit, math.inf))
                attachments = {**reader.attachments, **configuration_attachments(config, Path())}
                metadata = {name: texts for name, texts in reader.metadata.items() if name != "record"}
                view.begin(
                    replay.start_ns,
                    epoch_offset_ns=reader.epoch_offset_ns,
                    metadata=metadata,
                    attachments=attachments,
                )
            keys = stack.enter_context(Keys())
            line = stack.enter_context(
                ReplayLine(config.deflection_unit.shown, HELP if keys.available else "")
            )
            player = Player(
                replay,
                speed_factor,
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
                _wait_for_quit(keys)
        partial = replay.partial or replay.was_restarted or player.ended_by_user
        run = _analyse(reader, config, result, key_monitor)
        if partial:
            part = f"replayed from {replay.pipeline_start_s:.2f} s to {replay.position_s:.2f} s of the record"
            # a part has another end than the record
            run = replace(run, ended=None, warnings=(part, *run.warnings))
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
    return 1 if run.problem and config.lever is not None and not partial else 0


def _wait_for_quit(keys: Keys) -> None:
    """Wait for the key q, or Ctrl-C, which then ends only the page."""
    try:
        while "q" not in keys.pressed(_KEY_INTERVAL_S):
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
        while replay.advance(math.inf, MAX_FRAMES[retrack]) is not None:
            pass
        return _analyse(reader, config, replay.finish())


def _analyse(
    reader: RecordReader, config: Configuration, result: ReplayResult, monitor: KeyUseMonitor | None = None
) -> AnalysedRun:
    return analyse_run(
        reader,
        config,
        result.swings,
        result.deflections,
        config.deflection_unit,
        result.beam,
        lambda _: result.dropped_frames,
        key_monitor=monitor,
    )


def _say_differences(
    record: Path, replay: Replay, result: ReplayResult, run: AnalysedRun, *, partial: bool, retracked: bool
) -> None:
    """Print differences from the recorded spots, half-cycles and fitted parameters."""
    if replay.was_restarted:
        print_line(
            f"restarted at {replay.pipeline_start_s:.2f} s by going back: "
            "the results are not compared with the recorded ones"
        )
        return
    answer(comparison=result.comparison)
    print_comparison(result.comparison, partial=partial, retracked=retracked)
    if partial:
        return
    source, recorded = recorded_results(record, run.sha256)
    if recorded is None and not result.comparison.identical:
        source, recorded = "fitted", analyse_record(record)
    if recorded is not None:
        changes = parameter_changes(recorded, run)
        answer(changes=changes)
        print_changes(changes, source)
