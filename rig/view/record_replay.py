"""The command `rig replay`: replays a record, compares the results with the recorded ones, and fits them."""

import math
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from acquisition.record.events import Event
from acquisition.record.reader import RecordReader
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.units import nanoseconds
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
from rig.instrument import RecordContents, RunNow, configuration_attachments, recorded_configuration
from rig.presentation import (
    QuantityDisplay,
    Table,
    answer,
    columns_of,
    plain,
    print_line,
    print_tables,
    quantity,
    say,
    signed,
)
from rig.settings import Configuration, KeyUseMonitor
from rig.terminal import Terminated
from rig.view.replay import Replay, Replayed, ReplayStep
from rig.view.replay_comparison import ParameterDifference, ReplayDifferences, parameter_changes
from rig.view.scratch import ScratchHead, ScratchView
from rig.view.values import Mode

_PLAIN_INTERVAL_S, _LINE_INTERVAL_S, _LOOK_S = 5.0, 0.1, 0.2
_ERASE = "\r\x1b[K"
_OF_ROUNDING_U = 0.01
"""Largest change, in standard uncertainties, that is put down to rounding."""
_EXACT, _ASYMPTOTIC = "fits.exact.", "fits.asymptotic."


_MOST_FRAMES = {False: 10_000, True: 64}
"""Frames processed at a time: with recorded spots, and tracked again or shown piece by piece."""


class _Progress:
    """How far a replay is: a line that is written over on a terminal, elsewhere one every few seconds."""

    def __init__(self, replay: Replay, unit: DeflectionUnit) -> None:
        self._replay, self._unit = replay, unit
        self._begun_s, self._from_s = time.monotonic(), replay.position_s
        self._is_terminal = sys.stderr.isatty()
        self._due_s = self._begun_s if self._is_terminal else self._begun_s + _PLAIN_INTERVAL_S
        self._frames = 0
        self._now = RunNow()

    def take(self, step: ReplayStep) -> None:
        """Count what was replayed, and say it where that is due."""
        self._frames += len(step.sequences)
        self._now = self._now.after(RecordContents(swings=step.block.swings), self._unit)
        now_s, replay = time.monotonic(), self._replay
        if now_s < self._due_s:
            return
        self._due_s = now_s + (_LINE_INTERVAL_S if self._is_terminal else _PLAIN_INTERVAL_S)
        position_s, length_s = replay.position_s, replay.length_s
        part = 100 * position_s / length_s if length_s > 0 else 100.0
        text = f"replaying  {position_s:.2f} of {length_s:.1f} s  {part:.0f} %  {self._frames} frames"
        text += f"  {self._now.half_cycles} half-cycles"
        if math.isfinite(self._now.amplitude):
            text += f"  {self._now.amplitude:.2f} {self._unit.shown}"
        if (gone_s := position_s - self._from_s) > 0:
            left_s = (length_s - position_s) * (now_s - self._begun_s) / gone_s
            text += f"  about {round(left_s) // 60}:{round(left_s) % 60:02d} left"
        # a line that is wrapped could not be written over
        shown = _ERASE + text[: (columns_of(sys.stderr) or len(text) + 1) - 1]
        print(shown if self._is_terminal else text, end="" if self._is_terminal else "\n", file=sys.stderr)
        sys.stderr.flush()

    @property
    def half_cycles(self) -> int:
        """How many were found so far."""
        return self._now.half_cycles

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._is_terminal:
            print(_ERASE, end="", file=sys.stderr, flush=True)


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


def print_changes(changes: Sequence[ParameterDifference], source: str) -> None:
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
        shown = quantity(parameter) if parameter != name else QuantityDisplay(name, "", name)
        of_other = [_in_u(other) if other else ""] if asymptotic else []
        rows.append([shown.label, shown.text(*change.recorded), _in_u(change), *of_other])
    print_tables([Table("changes", "", head, rows, head, rows)])


def _in_u(change: ParameterDifference) -> str:
    return "?" if math.isnan(change.in_u) else signed(change.in_u)


def _largest(change_u: float, where: str, once: int, changed: int) -> str:
    """Which of those in both changed most, and how many are in one of the two only."""
    said = [f"{plain(change_u, 2)} u, {where}"] if change_u > 0 else []
    said += [f"{once} in one of the two only"] if once else []
    return "; ".join(said or ["only in uncertainties or flags"]) if changed else ""


def _events(reader: RecordReader) -> list[Event]:
    """Events and notes in order of time."""
    return sorted([*reader.events(), *(note.event for note in reader.notes())], key=lambda one: one.time_ns)


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
    """Replay, compare and fit; writes results.json into `output` if given. Returns the exit status.

    Raises ConfigurationError for invalid times, and RecordError for a file that cannot be replayed, before
    anything is written; RecordError at the end where the Rerun file is not whole.
    """
    if not 0 <= from_s < to_s:
        raise ConfigurationError(
            f"--from {from_s:g} --to {to_s:g}: the part must begin before it ends, from 0 on"
        )
    with RecordReader(record) as reader:
        remedy = "frames stay as they were recorded" if retrack else "what the tracker takes needs --retrack"
        watched = KeyUseMonitor(recorded_configuration(reader, overrides), overrides, remedy)
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
            result = _played(replay, config.deflection_unit, view, _events(reader), retrack=retrack)
            if mode == "web":
                say("the page has all of it and stays until Ctrl-C; the results follow then")
                _stay()
        partial = replay.partial
        run = replace(_analysed(reader, config, result), watched=watched)
        if partial:
            part = f"replayed from {from_s:.2f} s to {replay.position_s:.2f} s of the record"
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


def _played(
    replay: Replay, unit: DeflectionUnit, view: ScratchView | None, events: Sequence[Event], *, retrack: bool
) -> Replayed:
    """Process all frames, draw them into the view, and say meanwhile how far it is."""
    progress, coming = _Progress(replay, unit), deque(events)
    try:
        for step in replay.steps(_MOST_FRAMES[retrack or view is not None]):
            progress.take(step)
            if view is not None:
                view.block(step.block, step.pictures, sequences=step.sequences.tolist())
                position_ns = replay.start_ns + nanoseconds(replay.position_s)
                while coming and coming[0].time_ns <= position_ns:
                    view.event(coming.popleft())
    finally:
        progress.close()
    result = replay.finish()
    if view is not None:
        for event in () if replay.partial else coming:
            view.event(event)
        view.half_cycles(result.swings[progress.half_cycles :])
        view.flush()
    return result


def _stay() -> None:
    """Wait for Ctrl-C, which ends no more than the page."""
    try:
        while True:
            time.sleep(_LOOK_S)
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
        for _ in replay.steps(_MOST_FRAMES[retrack]):
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
