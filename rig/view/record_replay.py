"""`rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

import math
import tempfile
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
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
from rig.settings import ALL, REPLAYED, Configuration, refuse_without_effect
from rig.terminal import (
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
from rig.view.scratch import Mode, no_window
from rig.view.show import show_records


def print_comparison(comparison: ReplayDifferences, *, partial: bool) -> None:
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
    if partial:
        say(
            "half-cycles of a part differ in any case: they are numbered from its beginning, "
            "and the pipeline adapts to the frames before"
        )


def print_changes(changes: Sequence[ParameterDifference], source: str) -> None:
    """Print the changes of the quantities of the results; one line if nothing changed."""
    if not changes:
        return
    if all(change.change_u == 0.0 for change in changes):
        print_line(f"{len(changes)} fitted numbers, equal to those of {source}")
        return
    head = ("", "", f"{source}, u: swings", "change / u")
    rows = []
    for change in changes:
        shown, by_u = quantity(change.quantity), change.change_u
        size = "?" if math.isnan(by_u) else signed(by_u)
        rows.append([shown.label, change.fit, shown.text(*change.recorded), size])
    print_tables([Table("changes", "", head, head, [TableRow(row, row) for row in rows])])


def _largest(differences: Differences, place: str) -> str:
    """The largest change of those present in both, and the number of those present in only one, in words."""
    texts = [f"{plain(differences.largest_u, 2)} u, {place}"] if differences.largest_u > 0 else []
    texts += [f"{differences.once} in one of the two only"] if differences.once else []
    return "; ".join(texts or ["only in uncertainties or flags"]) if differences.changed else ""


def replay_record(
    record: Path,
    output: Path | None,
    *,
    retrack: bool,
    overrides: Sequence[str],
    from_s: float = 0.0,
    to_s: float = math.inf,
    mode: Mode = "none",
    rrd: Path | None = None,
) -> int:
    """Replay, compare and fit a record; writes results.json into `output` if given. Returns the exit status.

    The view, or the Rerun file, comes last: it shows a record of the replay that lasts as long as the view.
    Raises ConfigurationError for invalid times, and RecordError for a file that cannot be replayed, before
    anything is written; RecordError at the end if the Rerun file is not whole.
    """
    if not 0 <= from_s < to_s:
        raise ConfigurationError(
            f"--from {from_s:g} --to {to_s:g}: the part must begin before it ends, from 0 on"
        )
    if mode == "spawn" and (missing := no_window()):
        raise ConfigurationError(missing)
    with RecordReader(record) as reader, tempfile.TemporaryDirectory(prefix="rig-replay-") as folder:
        config = recorded_configuration(reader, overrides)
        remedy = "frames stay as they were recorded" if retrack else "what the tracker takes needs --retrack"
        refuse_without_effect(overrides, {**REPLAYED, **({"sensor": ALL} if retrack else {})}, remedy)
        if reader.truncated:
            say(reader.cut_notice)
        replay = Replay(reader, config, retrack=retrack, from_s=from_s, to_s=to_s)
        again = Path(folder) / f"replay of {record.stem}.mcap" if mode != "none" or rrd is not None else None
        result = _replayed(reader, replay, config, again)
        run = _analyse(reader, config, result)
        if replay.partial:
            part = f"replayed from {replay.from_s:.2f} s to {replay.to_s:.2f} s of the record"
            # a part has another end than the record
            run = replace(run, ended=None, warnings=(part, *run.warnings))
        results = session_results([run], output or record.parent)
        _say_differences(record, replay, result, run)
        print_results(results, [])
        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
            write_results(output / RESULTS_NAME, results)
            answer(written=[output / RESULTS_NAME])
            print(f"results      {output / RESULTS_NAME}")
        if again is not None and mode != "none":
            show_records([again], mode=mode)
        if again is not None and rrd is not None:
            show_records([again], rrd=rrd)
            answer(written=[rrd])
            print(f"Rerun file   {rrd}")
    return 1 if run.problem and config.lever is not None and not replay.partial else 0


def _replayed(
    reader: RecordReader, replay: Replay, config: Configuration, again: Path | None
) -> ReplayResult:
    """Replay to the end, with a bar of the progress; the results are also recorded in the file `again`."""
    console, recorded = Console(stderr=True), 0
    with (
        nullcontext() if again is None else closing(_writer(again, reader, config)) as writer,
        Progress(console=console, transient=True, disable=not console.is_terminal) as progress,
    ):
        task = progress.add_task("replaying", total=replay.to_s - replay.from_s)
        for sequences, block in replay.blocks():
            times_ns = block.deflections.times_ns.tolist()
            if writer is not None:
                block.write(writer, sequences.tolist(), times_ns, times_ns)
                recorded += len(block.swings)
            progress.update(task, completed=replay.elapsed_s(times_ns[-1]) - replay.from_s)
        result = replay.finish()
        if writer is not None:
            for swing in result.swings[recorded:]:
                writer.write_swing(swing)
            for event in (*reader.events(), *(note.event for note in reader.notes())):
                if not replay.partial or replay.from_s <= replay.elapsed_s(event.time_ns) <= replay.to_s:
                    writer.write_event(*event)
    return result


def _writer(again: Path, reader: RecordReader, config: Configuration) -> RecordWriter:
    """A new record with the head of another, but for the configuration."""
    return RecordWriter(
        again,
        reader.epoch_offset_ns,
        metadata={name: texts for name, texts in reader.metadata.items() if name != "record"},
        attachments={**reader.attachments, **configuration_attachments(config, Path())},
        deflection_unit=config.deflection_unit,
    )


def analyse_replayed(record: Path, *, retrack: bool, overrides: Sequence[str] = ()) -> AnalysedRun:
    """Fit the half-cycles found again in the recorded spots, or with `retrack` in the recorded pixels.

    Nothing is shown or written. Raises RecordError for a record that cannot be replayed.
    """
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, overrides)
        replay = Replay(reader, config, retrack=retrack)
        for _ in replay.blocks():
            pass
        return _analyse(reader, config, replay.finish())


def _analyse(reader: RecordReader, config: Configuration, result: ReplayResult) -> AnalysedRun:
    return analyse_run(
        reader,
        config,
        result.swings,
        result.deflections,
        config.deflection_unit,
        result.beam,
        lambda _: result.dropped_frames,
    )


def _say_differences(record: Path, replay: Replay, result: ReplayResult, run: AnalysedRun) -> None:
    """Print differences from the recorded spots, half-cycles and fitted parameters."""
    answer(comparison=result.comparison)
    print_comparison(result.comparison, partial=replay.partial)
    if replay.partial:
        return
    source, recorded = recorded_results(record, run.sha256)
    if recorded is None and not result.comparison.identical:
        source, recorded = "fitted", analyse_record(record)
    if recorded is not None:
        changes = parameter_changes(recorded, run)
        answer(changes=changes)
        print_changes(changes, source)
