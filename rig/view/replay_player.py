"""Replays a record at a given speed, with pause, step and seek by keys, and a line of its progress."""

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import IO, Final, Self

from acquisition.record.events import Event
from processing.spot import SpotFlag
from processing.units import nanoseconds
from rig.instrument import RecordContents, RunNow
from rig.terminal import Keys, terminal_columns
from rig.view.replay import Replay, ReplayResult, ReplayStep
from rig.view.scratch import ScratchView

HELP: Final = "space pause  → frame  h half-cycle  + - 10 s  g go to  q end"
SEEK_S: Final = 10.0
_MIN_WAIT_S = 0.05
_MAX_WAIT_S = 0.5
_MIN_TIMED_S = 2.0
"""Shortest time from which the speed of a replay is estimated."""
MAX_FRAMES = {False: 10_000, True: 64}
"""Most frames between two checks of the keys: with recorded spots; with spots tracked again or shown."""


_PLAIN_INTERVAL_S = 5.0
_LINE_INTERVAL_S = 0.1
_ERASE_LINE = "\r\x1b[K"


class ReplayLine:
    """The progress of a replay: one line updated on a terminal, elsewhere a new line every few seconds.

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
        # while paused or typing nothing is delayed, so that the effect of a key is shown immediately
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
            self._stream.write(_ERASE_LINE + text)
            self._stream.flush()

    def _text(self, state: RunNow, doing: str, length_s: float, remaining_s: float) -> str:
        columns = terminal_columns(self._stream)
        part = 100 * state.elapsed_s / length_s if length_s > 0 else 100.0
        amplitude = "" if math.isnan(state.amplitude) else f"  {state.amplitude:.2f} {self._unit}"
        left = "" if math.isnan(remaining_s) else f"  about {_clock(remaining_s)} left"
        begin = f"{doing}  {state.elapsed_s:.2f} of {length_s:.1f} s  {part:.0f} %"
        half_cycles = f"  {state.half_cycles} half-cycles"
        texts = [f"  {state.frames} frames", half_cycles, amplitude, left]
        # a wrapped line could not be overwritten, so parts are left out, the least important first
        for place, _ in enumerate(texts):
            if columns and len(begin) + sum(map(len, texts)) >= columns:
                texts[place] = ""
        return begin + "".join(texts)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class Player:
    """Runs one replay, controlled by keys.

    Parameters
    ----------
    speed
        Speed relative to real time; infinite: as fast as possible. If processing is slower than that,
        the replay is slower, and no frame is skipped.
    events
        Events of the record, for the log of the view.
    clock
        Returns the time of the host in s.
    """

    def __init__(
        self,
        replay: Replay,
        speed: float,
        keys: Keys,
        line: ReplayLine,
        *,
        retrack: bool = False,
        view: ScratchView | None = None,
        events: Sequence[Event] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._replay = replay
        self._speed = speed
        self._keys = keys
        self._line = line
        # a view is drawn in small pieces, as during the run
        self._max_frames = MAX_FRAMES[retrack or view is not None]
        self._view = view
        self._events = sorted(events, key=lambda event: event.time_ns)
        self._clock = clock
        self._typed: str | None = None
        self._target_s = -math.inf
        self._step: str = ""
        self._last_sequence = -1
        self.paused = False
        self.ended_by_user = False
        self._begun = False
        self._now = RunNow()
        self._reset_counts()

    def play(self) -> None:
        """Replay until the end, or until the user ends it."""
        wait_s = 0.0
        while not self.ended_by_user:
            for key in self._keys.pressed(wait_s):
                self._obey_key(key)
            if self.ended_by_user or math.isinf(self._replay.next_s):
                break
            self._show()
            wait_s = self._process_due()
        self._show()

    def finish(self) -> ReplayResult:
        """Complete the last half-cycles and show them; returns the results."""
        result = self._replay.finish()
        if self._view is not None:
            self._view.half_cycles(result.swings[self._now.half_cycles :])
            self._view.flush()
        return result

    def _process_due(self) -> float:
        """Process the frames that are due; returns the time in s until the next one."""
        if self._replay.next_s <= self._target_s:
            self._advance(self._target_s, self._max_frames)
            if self._replay.next_s > self._target_s:
                self._resume()
            return 0.0
        if self._step:
            self._step_once()
            return 0.0
        if self.paused:
            return _MAX_WAIT_S
        if math.isinf(self._speed):
            self._advance(math.inf, self._max_frames)
            return 0.0
        due_s = self._base_s + (self._clock() - self._base_clock_s) * self._speed
        self._advance(due_s, self._max_frames)
        behind = self._replay.next_s <= due_s
        return (
            0.0 if behind else min(_MAX_WAIT_S, max(_MIN_WAIT_S, (self._replay.next_s - due_s) / self._speed))
        )

    def _step_once(self) -> None:
        """Process one frame, or as many as it takes to complete a half-cycle."""
        for _ in range(1 if self._step == "frame" else self._max_frames):
            step = self._advance(math.inf, 1)
            if step is None or self._step == "frame" or step.block.swings:
                self._step = ""
                self._resume()
                return

    def _advance(self, until_s: float, most: int) -> ReplayStep | None:
        step = self._replay.advance(until_s, most)
        if step is None:
            return None
        block, now = (
            step.block,
            self._now.after(RecordContents(swings=step.block.swings), step.block.deflections.unit),
        )
        missing = int(step.sequences[-1]) - self._last_sequence - len(step.sequences)
        self._last_sequence = int(step.sequences[-1])
        self._now = replace(
            now,
            frames=now.frames + len(step.sequences),
            dropped_frames=now.dropped_frames + missing,
            lost_spots=now.lost_spots + sum(bool(spot.flags & SpotFlag.LOST) for spot in block.spots),
        )
        self._draw(step)
        if not self._begun:
            # the first frames wait for loading and compiling, so their time does not count for the speed
            self._begun = True
            self._resume()
        return step

    def _draw(self, step: ReplayStep) -> None:
        if self._view is None:
            return
        start_ns = self._replay.start_ns
        self._view.block(step.block, step.pictures, sequences=step.sequences.tolist())
        position_ns = start_ns + nanoseconds(self._replay.position_s)
        while self._next_event < len(self._events) and (
            self._events[self._next_event].time_ns <= position_ns or math.isinf(self._replay.next_s)
        ):
            self._view.event(self._events[self._next_event])
            self._next_event += 1

    def _obey_key(self, key: str) -> None:
        """Carry out the command of a key."""
        if self._typed is not None:
            self._edit_time(key)
        elif key == "space":
            self.paused = not self.paused
            self._resume()
        elif key in ("right", "n", "h"):
            self.paused, self._step = True, "half-cycle" if key == "h" else "frame"
        elif key in ("+", "=", "-"):
            self._seek(self._replay.position_s + (-SEEK_S if key == "-" else SEEK_S))
        elif key == "g":
            self._typed = ""
        elif key == "q":
            self.ended_by_user = True

    def _edit_time(self, key: str) -> None:
        """Edit the time to go to by a key."""
        typed = self._typed or ""
        if key in "0123456789." and len(key) == 1:
            self._typed = typed + key
        elif key == "backspace":
            self._typed = typed[:-1]
        elif key == "enter":
            self._typed = None
            if typed.strip(".") and typed.count(".") <= 1:
                self._seek(float(typed))
        elif key in ("escape", "q", "g"):
            self._typed = None

    def _seek(self, time_s: float) -> None:
        """Go to a time: forwards all frames are processed, backwards the pipeline is restarted."""
        replay = self._replay
        time_s = min(max(time_s, 0.0), replay.length_s)
        if time_s > replay.position_s:
            self._target_s = time_s
            return
        self._target_s = -math.inf
        replay.restart(time_s)
        if self._view is not None:
            self._view.restart(replay.start_ns + nanoseconds(time_s))
        self._reset_counts()

    def _reset_counts(self) -> None:
        """Reset the counts when the pipeline is restarted."""
        start_ns, begun_s = self._replay.start_ns, self._replay.pipeline_start_s
        begun_ns = start_ns + nanoseconds(begun_s)
        self._now = RunNow()
        self._last_sequence = self._replay.next_sequence - 1
        self._next_event = sum(event.time_ns < begun_ns for event in self._events) if begun_s > 0 else 0
        self._resume()

    def _resume(self) -> None:
        """Restart the timing of the replay speed at the present position."""
        self._base_clock_s, self._base_s = self._clock(), self._replay.position_s

    def _show(self) -> None:
        replay = self._replay
        position_s = replay.position_s
        replayed_s, host_s = position_s - self._base_s, self._clock() - self._base_clock_s
        known = replayed_s > 0 and host_s > _MIN_TIMED_S and not self.paused
        remaining_s = (replay.length_s - position_s) * host_s / replayed_s if known else math.nan
        now = replace(self._now, elapsed_s=position_s)
        self._line.show(now, replay.length_s, remaining_s, self._typed, paused=self.paused)
