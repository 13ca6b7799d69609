"""Terminal output of a replay: a progress line, and the comparison at the end."""

import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import IO, Self

from rig.instrument import RunNow
from rig.presentation import (
    Shown,
    Table,
    columns_of,
    plain,
    print_line,
    print_tables,
    quantity,
    say,
    signed,
)
from rig.replay.comparison import Change, ReplayDifferences

_PLAIN_INTERVAL_S = 5.0
_LINE_INTERVAL_S = 0.1
_ERASE = "\r\x1b[K"
_OF_ROUNDING_U = 0.01
"""Largest change, in standard uncertainties, that is put down to rounding."""
_EXACT, _ASYMPTOTIC = "fits.exact.", "fits.asymptotic."


class ReplayLine:
    """A progress line that is updated on a terminal; elsewhere a new line every few seconds.

    On a terminal `help_text` is printed first.
    """

    def __init__(
        self,
        unit: str,
        help_text: str = "",
        *,
        stream: IO[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()
        self._unit = unit
        self._help = help_text
        self._clock = clock
        self._shown_s = clock() if not self._terminal else -math.inf
        self._shown = ""

    def __enter__(self) -> Self:
        if self._terminal and self._help:
            self._stream.write(f"keys: {self._help}\n")
            self._stream.flush()
        return self

    def __exit__(self, *_error: object) -> None:
        if self._terminal and self._shown:
            self._stream.write("\n")
            self._stream.flush()

    def show(
        self, now: RunNow, length_s: float, remaining_s: float, prompt: str | None, *, paused: bool
    ) -> None:
        """Update the line."""
        now_s = self._clock()
        interval_s = _LINE_INTERVAL_S if self._terminal else _PLAIN_INTERVAL_S
        # the effect of a key is shown immediately
        moving = not paused and prompt is None and now.elapsed_s < length_s
        if (moving or not self._terminal) and now_s - self._shown_s < interval_s:
            return
        doing = "paused" if paused else "replaying"
        text = prompt if prompt is None else f"go to (seconds from the start, Enter): {prompt}"
        text = text or self._text(now, doing, length_s, remaining_s)
        if not self._terminal:
            self._shown_s = now_s
            self._stream.write(f"{text}\n")
            self._stream.flush()
        elif text != self._shown:
            self._shown_s, self._shown = now_s, text
            self._stream.write(_ERASE + text)
            self._stream.flush()

    def _text(self, state: RunNow, doing: str, length_s: float, remaining_s: float) -> str:
        columns = columns_of(self._stream)
        part = 100 * state.elapsed_s / length_s if length_s > 0 else 100.0
        amplitude = "" if math.isnan(state.amplitude) else f"  {state.amplitude:.2f} {self._unit}"
        clock = f"  clock {state.clock.text}" if state.clock.text else ""
        left = "" if math.isnan(remaining_s) else f"  about {_clock(remaining_s)} left"
        begin = f"{doing}  {state.elapsed_s:.2f} of {length_s:.1f} s  {part:.0f} %"
        half_cycles = f"  {state.half_cycles} half-cycles"
        texts = [f"  {state.frames} frames", clock, half_cycles, amplitude, left]
        # a line that is wrapped could not be written over; the first of these is missed least
        for place, _ in enumerate(texts):
            if columns and len(begin) + sum(map(len, texts)) >= columns:
                texts[place] = ""
        return begin + "".join((texts[0], *texts[2:4], texts[1], texts[4]))


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


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
