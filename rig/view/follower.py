"""The drawer of a record, complete or still being written, in the pieces in which it was flushed.

The drawing does not depend on when a piece is read, so that a live view equals a later one.
"""

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.events import EventKind
from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import REFERENCE, SPOT, RecordedEstimate, RecordedHealth, RecordedPhase
from processing.arrays import Floats
from processing.balance import Balance
from processing.errors import RecordError
from processing.estimate import Estimate
from processing.spot import SpotFlag
from processing.swing import HalfCycle
from processing.units import nanoseconds, seconds
from rig.instrument import Phase, RecordContents, RunNow, advice_for, piece_contents, recorded_configuration
from rig.settings import Configuration
from rig.terminal import balance_numbers
from rig.view import layout
from rig.view.drawing import Drawing

_STATE_INTERVAL_NS, _LOSSES_INTERVAL_NS = 1_000_000_000, 10_000_000_000
"""Intervals of run time at which state and losses are drawn, even without a change."""
_MAX_PIECES = 64
"""Number of the last pieces whose spots are kept for pictures."""


class RecordDrawer:
    """Draws a record; `picture_interval_s` is the shortest interval of pictures in run time."""

    def __init__(self, reader: RecordReader, drawing: Drawing, *, picture_interval_s: float) -> None:
        self._reader, self._drawing = reader, drawing
        self._picture_interval_ns = nanoseconds(picture_interval_s)
        self._config = configuration_of(reader)
        self._shape = reader.picture_shape
        self._early_pieces: list[Piece] = []
        self._start_ns: int | None = None
        self._last_ns = 0
        self._next_sequence = 0
        self._spots: deque[NDArray[Any]] = deque(maxlen=_MAX_PIECES)
        self._pictures: deque[tuple[int, int, bytes]] = deque()
        self._state_due_ns = self._losses_due_ns = 0
        self._last_losses = (-1, -1)
        self._now = RunNow()
        self._has_advice = self._has_ended = False
        self.frames = self.missing = self.lost = 0

    def take(self) -> None:
        """Draw what was flushed since the last call."""
        for piece in self._reader.unread():
            self._early_pieces.append(piece)
            if self._start_ns is None:
                self._start_ns = self._first_ns(piece)
            if self._start_ns is not None:
                for early in self._early_pieces:
                    self._draw(early)
                self._early_pieces.clear()
                self._draw_pictures()
            self._drawing.send()

    def finish(self) -> None:
        """Draw the rest of a record that has ended."""
        self.take()
        self._has_ended = True
        if self._start_ns is not None:
            self._draw_pictures(draws_all=True)
            self._draw_losses()
            self._draw_state()
        self._drawing.send(now=True)

    def _first_ns(self, piece: Piece) -> int | None:
        """Time of the run's first frame, from the first piece that contains it; else None."""
        if SPOT.topic in piece:
            return int(self._reader.table(SPOT.topic, piece)["time_ns"][0])
        events = self._reader.events(piece)
        return next((event.time_ns for event in events if event.kind == EventKind.START), None)

    def _run_s(self, times_ns: int) -> float:
        return seconds(times_ns - (self._start_ns or 0))

    def _draw(self, piece: Piece) -> None:
        reader, drawing = self._reader, self._drawing
        contents = piece_contents(reader, piece, self._start_ns or 0, self._last_ns)
        previous, self._now = self._now, self._now.with_contents(contents, reader.deflection_unit)
        # balances first: their lines separate the samples of the same piece
        self._draw_balances(contents.balances)
        for topic, draw in ((SPOT.topic, self._draw_spots), (REFERENCE.topic, self._draw_references)):
            if topic in piece:
                draw(reader.table(topic, piece))
        self._draw_half_cycles(contents.half_cycles)
        for event in contents.events:
            if event.kind == EventKind.ADVICE:
                self._has_advice = True
                drawing.text(layout.ADVICE, self._run_s(event.time_ns), event.text)
            else:
                drawing.event(self._run_s(event.time_ns), event)
        self._draw_session(contents, previous)

    def _draw_spots(self, rows: NDArray[Any]) -> None:
        deflections = self._reader.deflections(rows)
        time_s = self._times_s(deflections.times_ns)
        flags = rows["flags"].astype(np.int64)
        self._drawing.samples(time_s, deflections.shown_x, deflections.shown_y, flags)
        self._spots.append(rows[["sequence", "x_px", "y_px"]])
        sequence = rows["sequence"]
        if not self.frames:
            # a damaged record may begin at a later frame
            self._next_sequence = int(sequence[0])
        self.missing += int(sequence[-1]) + 1 - self._next_sequence - len(rows)
        self.lost += int(np.count_nonzero(flags & SpotFlag.LOST))
        self.frames += len(rows)
        self._next_sequence = int(sequence[-1]) + 1
        self._last_ns = int(rows["time_ns"][-1])
        if (self.missing, self.lost) != self._last_losses or self._last_ns >= self._losses_due_ns:
            self._draw_losses()
        if self._last_ns >= self._state_due_ns:
            self._draw_state()

    def _draw_references(self, rows: NDArray[Any]) -> None:
        lost = (rows["flags"] & SpotFlag.LOST) != 0
        x_px, y_px = (np.where(lost, np.nan, rows[name]) for name in ("x_px", "y_px"))
        self._drawing.reference(self._times_s(rows["time_ns"]), x_px, y_px)

    def _draw_half_cycles(self, half_cycles: Sequence[HalfCycle]) -> None:
        size = self._reader.deflection_unit.shown_size
        rows = [(h.amplitude, h.u_amplitude, h.half_period_s, h.u_half_period_s) for h in half_cycles]
        amplitude, u_amplitude, half_s, u_half_s = np.array(rows).reshape(-1, 4).T
        time_s = self._times_s(np.array([h.turn_time_ns for h in half_cycles], dtype=np.int64))
        self._drawing.half_cycles(
            time_s, (amplitude / size, u_amplitude / size), (2.0 * half_s, 2.0 * u_half_s)
        )

    def _draw_balances(self, balances: Sequence[Balance]) -> None:
        for balance in balances:
            time_s = self._run_s(balance.time_ns)
            self._drawing.balance(time_s, balance_numbers(balance))
            if self._config is None or self._has_advice:
                continue
            if advice := advice_for(self._config, balance).markdown:
                self._drawing.text(layout.ADVICE, time_s, advice)

    def _draw_session(self, contents: RecordContents, previous: RunNow) -> None:
        """Draw messages on the session: phase, clock, estimates."""
        clock, drawing = self._now.clock, self._drawing
        for health in contents.messages_of_kind(RecordedHealth):
            if clock.is_known and clock != previous.clock:
                drawing.clock(self._run_s(health.time_ns), clock.drift_ppm, clock.u_drift_ppm)
        rows = contents.messages_of_kind(RecordedEstimate)
        for time_ns in dict.fromkeys(row.time_ns for row in rows):
            estimates = {
                row.quantity: Estimate(row.value, row.u_value) for row in rows if row.time_ns == time_ns
            }
            drawing.estimates(self._run_s(time_ns), estimates)
        if contents.messages_of_kind(RecordedPhase):
            self._draw_state()

    def _draw_pictures(self, *, draws_all: bool = False) -> None:
        """Draw the pictures whose spots are known, or all pictures."""
        until_ns = self._reader.numbers.end_ns if draws_all else self._last_ns
        self._pictures.extend(self._reader.unread_pictures(self._picture_interval_ns, until_ns))
        while self._pictures and (draws_all or self._pictures[0][0] < self._next_sequence):
            sequence, time_ns, jpeg = self._pictures.popleft()
            shape, step = self._shape
            x_px, y_px = self._spot_of(sequence)
            # each pixel of a reduced picture is the first of `step` pixels
            self._drawing.picture(self._run_s(time_ns), jpeg, shape, (x_px / step, y_px / step))

    def _spot_of(self, sequence: int) -> tuple[float, float]:
        for rows in reversed(self._spots):
            if rows["sequence"][0] <= sequence:
                index = int(np.searchsorted(rows["sequence"], sequence))
                if index < len(rows) and rows["sequence"][index] == sequence:
                    return float(rows["x_px"][index]), float(rows["y_px"][index])
                break
        return math.nan, math.nan

    def _draw_losses(self) -> None:
        self._last_losses = self.missing, self.lost
        self._losses_due_ns = self._last_ns + _LOSSES_INTERVAL_NS
        counts = {"missing_frames": self.missing, "lost_spots": self.lost}
        self._drawing.losses(self._run_s(self._last_ns), counts)

    def _draw_state(self) -> None:
        self._state_due_ns = self._last_ns + _STATE_INTERVAL_NS
        self._drawing.text(layout.STATE, self._run_s(self._last_ns), self._state())

    def _state(self) -> str:
        """Phase, amplitude, frames and losses in Markdown; the time of day shows how far a page lags."""
        state, unit = self._now, self._reader.deflection_unit
        clock = time.localtime(seconds(self._last_ns + self._reader.epoch_offset_ns))
        lines = [f"state of {time.strftime('%H:%M:%S', clock)}", f"time {self._run_s(self._last_ns):.1f} s"]
        if math.isfinite(state.amplitude):
            lines.append(f"amplitude {state.amplitude:.2f} {unit.shown}")
        if math.isfinite(state.period_s):
            lines.append(f"period {state.period_s:.4f} s")
        lines.append(f"{self.frames} frames, {self.missing} dropped, {self.lost} spots lost")
        lines += [f"camera's clock {state.clock.text}"] if state.clock.text else []
        lines += [f"beam: {state.beam}"] if state.beam else []
        if not math.isnan(state.frame_age_s):
            lines.append(f"frames were {state.frame_age_s * 1e3:.0f} ms old when they were processed")
        if state.losses.total:
            lines.append(f"lost: {state.losses}")
        lines.append(f"{state.half_cycles} half-cycles")
        alarm = f"# {state.alarm.upper()}\n\n" if state.alarm else ""
        activity = "recorded"
        if self._has_ended:
            activity = "cut short" if self._reader.truncated else "done"
        elif state.phase is not Phase.WAITING:
            activity = " ".join(filter(None, (state.phase, state.progress)))
        reason = f": {state.reason}" if state.reason else ""
        instruction = f"{state.instruction}\n\n" if state.instruction and not self._has_ended else ""
        return (
            f"{alarm}**{activity}**{reason}\n\n{instruction}"
            + "\n".join(f"- {line}" for line in lines)
            + "\n"
        )

    def _times_s(self, times_ns: NDArray[np.int64]) -> Floats:
        return np.asarray(seconds(times_ns - (self._start_ns or 0)), dtype=np.float64)


def configuration_of(reader: RecordReader) -> Configuration | None:
    """The configuration of a record; None if it has no usable one."""
    try:
        return recorded_configuration(reader)
    except RecordError:
        return None
