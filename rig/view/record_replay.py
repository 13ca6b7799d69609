"""`rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

import math
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from acquisition.record.reader import RecordReader
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
from rig.instrument import recorded_configuration
from rig.settings import ALL, REPLAYED, Configuration, refuse_without_effect
from rig.terminal import Table, answer, plain, print_line, print_tables, quantity, say, signed
from rig.view.replay import Replay, ReplayResult
from rig.view.replay_comparison import Differences, ParameterDifference, ReplayDifferences, parameter_changes


def _print_comparison(comparison: ReplayDifferences) -> None:
    """Print one line if nothing differs, else a short table of spots and half-cycles."""
    spots, half_cycles = comparison.spots, comparison.half_cycles
    if comparison.identical:
        flagged = f" ({comparison.flagged} flagged and not fitted)" if comparison.flagged else ""
        print_line(
            f"{comparison.frames} spots and {half_cycles.replayed} half-cycles{flagged}, "
            "equal bit for bit to the recorded ones"
        )
        return
    rows = [
        [name, *map(str, differences[:3]), _largest_change(differences, position)]
        for name, differences, position in (
            ("spots", spots, f"frame {spots.largest_at:.0f}"),
            ("half-cycles", half_cycles, f"{half_cycles.largest_at:.1f} s"),
        )
    ]
    head = ("", "recorded", "replayed", "changed", "largest change")
    print_tables([Table("comparison", "", head, rows)])


def _print_changes(changes: Sequence[ParameterDifference], source: str) -> None:
    """Print the changes of the quantities of the results; one line if nothing changed."""
    if not changes:
        return
    if all(change.change_u == 0.0 for change in changes):
        print_line(f"{len(changes)} fitted numbers, equal to those of {source}")
        return
    head = ("", "", f"{source}, u: swings", "change / u")
    rows = []
    for change in changes:
        display = quantity(change.quantity)
        change_u = "?" if math.isnan(change.change_u) else signed(change.change_u)
        rows.append([display.label, change.fit, display.text(*change.recorded), change_u])
    print_tables([Table("changes", "", head, rows)])


def _largest_change(differences: Differences, position: str) -> str:
    """Text on the largest change, with its position, and on spots or half-cycles in one of the two only."""
    texts = [f"{plain(differences.largest_u, 2)} u, {position}"] if differences.largest_u > 0 else []
    texts += [f"{differences.once} in one of the two only"] if differences.once else []
    return "; ".join(texts or ["only in uncertainties or flags"]) if differences.changed else ""


def replay_record(record: Path, output: Path | None, *, retrack: bool, overrides: Sequence[str]) -> int:
    """Replay, compare and fit a record; writes results.json into `output` if given. Returns the exit status.

    Raises RecordError for a file that cannot be replayed, before anything is written.
    """
    console = Console(stderr=True)
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, overrides)
        remedy = "frames stay as they were recorded" if retrack else "what the tracker takes needs --retrack"
        refuse_without_effect(overrides, {**REPLAYED, **({"sensor": ALL} if retrack else {})}, remedy)
        if reader.truncated:
            say(reader.cut_notice)
        replay = Replay(reader, config, retrack=retrack)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task("replaying", total=replay.duration_s)
            for _, block in replay.blocks():
                last_ns = int(block.deflections.times_ns[-1])
                progress.update(task, completed=replay.elapsed_s(last_ns))
        result = replay.finish()
        run = _analyse(reader, config, result)
        results = session_results([run], output or record.parent)
        _print_differences(record, result, run)
        print_results(results, [])
        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
            write_results(output / RESULTS_NAME, results)
            answer(written=[output / RESULTS_NAME])
            print(f"results      {output / RESULTS_NAME}")
    return 1 if run.problem and config.lever is not None else 0


def analyse_replayed(record: Path, *, retrack: bool, overrides: Sequence[str] = ()) -> AnalysedRun:
    """Fit the half-cycles detected again in the recorded spots, or with `retrack` in the recorded pixels.

    Nothing is printed or written. Raises RecordError for a record that cannot be replayed.
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
        result.half_cycles,
        result.deflections,
        config.deflection_unit,
        result.beam,
        lambda _: result.dropped_frames,
        balances=result.balances,
    )


def _print_differences(record: Path, result: ReplayResult, run: AnalysedRun) -> None:
    """Print differences from the recorded spots, half-cycles and fitted parameters."""
    answer(comparison=result.comparison)
    _print_comparison(result.comparison)
    source, recorded = recorded_results(record, run.sha256)
    if recorded is None and not result.comparison.identical:
        source, recorded = "fitted", analyse_record(record)
    if recorded is not None:
        changes = parameter_changes(recorded, run)
        answer(changes=changes)
        _print_changes(changes, source)
