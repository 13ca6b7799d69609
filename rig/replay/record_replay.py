"""The command `rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

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
from rig.instrument import recorded_configuration
from rig.presentation import (
    Shown,
    Table,
    TimeLeft,
    answer,
    plain,
    print_line,
    print_tables,
    quantity,
    say,
    signed,
)
from rig.replay.comparison import Change, ReplayDifferences, parameter_changes
from rig.replay.replay import Replay, Replayed
from rig.settings import Configuration, Watched

_MOST_FRAMES = {False: 10_000, True: 64}
"""Frames processed at a time: with recorded spots, and tracked again."""
_OF_ROUNDING_U = 0.01
"""Largest change, in standard uncertainties, that is put down to rounding."""
_EXACT, _ASYMPTOTIC = "fits.exact.", "fits.asymptotic."


def print_comparison(comparison: ReplayDifferences, *, partial: bool, retracked: bool = False) -> None:
    """Print one line if nothing differs, else a short table of spots and half-cycles."""
    if comparison.identical:
        flagged = comparison.swings_flagged
        apart = f" ({flagged} flagged and not fitted)" if flagged else ""
        print_line(
            f"{comparison.spots} spots and {comparison.swings_replayed} half-cycles{apart}, "
            "equal bit for bit to the recorded ones"
        )
        return
    found = comparison
    spots = (found.spots_found_recorded, found.spots_found_replayed, found.spots_changed)
    swings = (found.swings_recorded, found.swings_replayed, found.swings_changed)
    rows: list[list[str]] = []
    for name, counts, once, change_u, where in (
        ("spots", spots, found.spots_once, found.largest_spot_change_u, f"frame {found.largest_spot_frame}"),
        (
            "half-cycles",
            swings,
            found.swings_once,
            found.largest_swing_change_u,
            f"{found.largest_swing_s:.1f} s",
        ),
    ):
        rows.append([name, *map(str, counts), _largest(change_u, where, once, counts[-1])])
    head = ("", "recorded", "replayed", "changed", "largest change")
    print_tables([Table("comparison", "", head, rows, head, rows)])
    if retracked and not found.spots_once and 0 < found.largest_spot_change_u < _OF_ROUNDING_U:
        # each fit starts at the spot of the frame before, which carries the last digits on
        print_line(
            "the spots agree: pixels of a window are counted from another corner than those of the whole "
            "frame, so that sums are rounded differently"
        )
    if partial:
        say(
            "half-cycles of a part differ in any case: they are numbered from its beginning, "
            "and the pipeline adapts to the frames before"
        )


def print_changes(changes: Sequence[Change], source: str) -> None:
    """Print the changes of the recorded fitted parameters; one line if nothing changed.

    Of the two fits of the contact laws the exact one is shown with values, the other only with changes.
    """
    if not changes:
        return
    if all(change.in_u == 0.0 for change in changes):
        text = f"{len(changes)} fitted numbers, equal to those of {source}"
        print_line(text)
        return
    by_name = {change.name: change for change in changes}
    asymptotic = [change for name, change in by_name.items() if name.startswith(_ASYMPTOTIC)]
    head = ("", source, "change / u", *(["of the asymptotic fit"] if asymptotic else []))
    rows: list[list[str]] = []
    for name, change in by_name.items():
        if name.startswith(_ASYMPTOTIC):
            continue
        other = by_name.get(name.replace(_EXACT, _ASYMPTOTIC))
        parameter = name.removeprefix(_EXACT)
        shown = quantity(parameter) if parameter != name else Shown(name, "", name)
        of_other = [_in_u(other) if other else ""] if asymptotic else []
        rows.append([shown.label, shown.text(*change.recorded), _in_u(change), *of_other])
    print_tables([Table("changes", "", head, rows, head, rows)])


def _in_u(change: Change) -> str:
    return "?" if math.isnan(change.in_u) else signed(change.in_u)


def _largest(change_u: float, where: str, once: int, changed: int) -> str:
    """Which of those in both changed most, and how many are in one of the two only."""
    said = [f"{plain(change_u, 2)} u, {where}"] if change_u > 0 else []
    said += [f"{once} in one of the two only"] if once else []
    return "; ".join(said or ["only in uncertainties or flags"]) if changed else ""


def replay_record(
    record: Path,
    output: Path | None,
    *,
    retrack: bool,
    overrides: Sequence[str],
    from_s: float = 0.0,
    to_s: float = math.inf,
) -> int:
    """Replay, compare and fit; writes results.json into `output` if given. Returns the exit status.

    Raises ConfigurationError for invalid times, and RecordError for a file that cannot be replayed, before
    anything is written.
    """
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
        replay = Replay(reader, config, retrack=retrack, from_s=from_s, to_s=to_s)
        result = _through(replay, retrack)
        run = replace(_analysed(reader, config, result), watched=watched)
        if replay.partial:
            part = f"replayed from {from_s:.2f} s to {replay.position_s:.2f} s of the record"
            # the record's end is not that of the part
            found = replace(run.results, ended=None, warnings=(part, *run.results.warnings))
            run = replace(run, results=found)
    results = session_results([run], output or record.parent)
    _say_differences(record, result, run, partial=replay.partial, retracked=retrack)
    print_results(results, [])
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_results(output / RESULTS_NAME, results)
        answer(written=[output / RESULTS_NAME])
        print(f"results      {output / RESULTS_NAME}")
    return 1 if run.results.problem and config.lever is not None and not replay.partial else 0


def analyse_replayed(record: Path, *, retrack: bool, overrides: Sequence[str] = ()) -> AnalysedRun:
    """Fit the half-cycles found again in the recorded spots, or with `retrack` in the recorded pixels.

    Nothing is shown or written. Raises RecordError for a record that cannot be replayed.
    """
    with RecordReader(record) as reader:
        config = recorded_configuration(reader, overrides)
        return _analysed(reader, config, _through(Replay(reader, config, retrack=retrack), retrack))


def _through(replay: Replay, retrack: bool) -> Replayed:
    left = TimeLeft("seconds replayed")
    while replay.advance(_MOST_FRAMES[retrack]) is not None:
        left(round(replay.position_s), round(replay.length_s))
    return replay.finish()


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
    record: Path, result: Replayed, run: AnalysedRun, *, partial: bool, retracked: bool
) -> None:
    """Print differences from the recorded spots, half-cycles and fitted parameters."""
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
