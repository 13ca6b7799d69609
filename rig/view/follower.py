"""The plotter of a record, complete or still being written, in the pieces in which it was flushed.

The plot does not depend on when a piece is read, so that a live view equals a later one.
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
from rig.view.plotting import RunPlot

_STATE_INTERVAL_NS, _LOSSES_INTERVAL_NS = 1_000_000_000, 10_000_000_000
"""Intervals of run time at which state and losses are plotted, even without a change."""
_MAX_PIECES = 64
"""Number of the last pieces whose spots are kept for pictures."""


class RecordPlotter:
    """Plots a record; `picture_interval_s` is the shortest interval of pictures in run time."""

    def __init__(self, reader: RecordReader, plot: RunPlot, *, picture_interval_s: float) -> None:
        self._reader, self._run_plot = reader, plot
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
        """Plot what was flushed since the last call."""
        for piece in self._reader.unread():
            self._early_pieces.append(piece)
            if self._start_ns is None:
                self._start_ns = self._first_ns(piece)
            if self._start_ns is not None:
                for early in self._early_pieces:
                    self._plot_piece(early)
                self._early_pieces.clear()
                self._plot_pictures()
            self._run_plot.send()

    def finish(self) -> None:
        """Plot the rest of a record that has ended."""
        self.take()
        self._has_ended = True
        if self._start_ns is not None:
            self._plot_pictures(plots_all=True)
            self._plot_losses()
            self._plot_state()
        self._run_plot.send(now=True)

    def _first_ns(self, piece: Piece) -> int | None:
        """Time of the run's first frame, from the first piece that contains it; else None."""
        if SPOT.topic in piece:
            return int(self._reader.table(SPOT.topic, piece)["time_ns"][0])
        events = self._reader.events(piece)
        return next((event.time_ns for event in events if event.kind == EventKind.START), None)

    def _run_s(self, times_ns: int) -> float:
        return seconds(times_ns - (self._start_ns or 0))

    def _plot_piece(self, piece: Piece) -> None:
        reader, plot = self._reader, self._run_plot
        contents = piece_contents(reader, piece, self._start_ns or 0, self._last_ns)
        previous, self._now = self._now, self._now.with_contents(contents, reader.deflection_unit)
        # balances first: their lines separate the samples of the same piece
        self._plot_balances(contents.balances)
        for topic, plot_rows in ((SPOT.topic, self._plot_spots), (REFERENCE.topic, self._plot_references)):
            if topic in piece:
                plot_rows(reader.table(topic, piece))
        self._plot_half_cycles(contents.half_cycles)
        for event in contents.events:
            if event.kind == EventKind.ADVICE:
                self._has_advice = True
                plot.text(layout.ADVICE, self._run_s(event.time_ns), event.text)
            else:
                plot.event(self._run_s(event.time_ns), event)
        self._plot_session(contents, previous)

    def _plot_spots(self, rows: NDArray[Any]) -> None:
        deflections = self._reader.deflections(rows)
        time_s = self._times_s(deflections.times_ns)
        flags = rows["flags"].astype(np.int64)
        self._run_plot.samples(time_s, deflections.shown_x, deflections.shown_y, flags)
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
            self._plot_losses()
        if self._last_ns >= self._state_due_ns:
            self._plot_state()

    def _plot_references(self, rows: NDArray[Any]) -> None:
        lost = (rows["flags"] & SpotFlag.LOST) != 0
        x_px, y_px = (np.where(lost, np.nan, rows[name]) for name in ("x_px", "y_px"))
        self._run_plot.reference(self._times_s(rows["time_ns"]), x_px, y_px)

    def _plot_half_cycles(self, half_cycles: Sequence[HalfCycle]) -> None:
        size = self._reader.deflection_unit.shown_size
        rows = [(h.amplitude, h.u_amplitude, h.half_period_s, h.u_half_period_s) for h in half_cycles]
        amplitude, u_amplitude, half_s, u_half_s = np.array(rows).reshape(-1, 4).T
        time_s = self._times_s(np.array([h.turn_time_ns for h in half_cycles], dtype=np.int64))
        self._run_plot.half_cycles(
            time_s, (amplitude / size, u_amplitude / size), (2.0 * half_s, 2.0 * u_half_s)
        )

    def _plot_balances(self, balances: Sequence[Balance]) -> None:
        for balance in balances:
            time_s = self._run_s(balance.time_ns)
            self._run_plot.balance(time_s, balance_numbers(balance))
            if self._config is None or self._has_advice:
                continue
            if advice := advice_for(self._config, balance):
                self._run_plot.text(layout.ADVICE, time_s, advice)

    def _plot_session(self, contents: RecordContents, previous: RunNow) -> None:
        """Plot messages on the session: phase, clock, estimates."""
        clock, plot = self._now.clock, self._run_plot
        for health in contents.messages_of_kind(RecordedHealth):
            if clock.is_known and clock != previous.clock:
                plot.clock(self._run_s(health.time_ns), clock.drift_ppm, clock.u_drift_ppm)
        rows = contents.messages_of_kind(RecordedEstimate)
        for time_ns in dict.fromkeys(row.time_ns for row in rows):
            estimates = {
                row.quantity: Estimate(row.value, row.u_value) for row in rows if row.time_ns == time_ns
            }
            plot.estimates(self._run_s(time_ns), estimates)
        if contents.messages_of_kind(RecordedPhase):
            self._plot_state()

    def _plot_pictures(self, *, plots_all: bool = False) -> None:
        """Plot the pictures whose spots are known, or all pictures."""
        until_ns = self._reader.numbers.end_ns if plots_all else self._last_ns
        self._pictures.extend(self._reader.unread_pictures(self._picture_interval_ns, until_ns))
        while self._pictures and (plots_all or self._pictures[0][0] < self._next_sequence):
            sequence, time_ns, jpeg = self._pictures.popleft()
            shape, step = self._shape
            x_px, y_px = self._spot_of(sequence)
            # each pixel of a reduced picture is the first of `step` pixels
            self._run_plot.picture(self._run_s(time_ns), jpeg, shape, (x_px / step, y_px / step))

    def _spot_of(self, sequence: int) -> tuple[float, float]:
        for rows in reversed(self._spots):
            if rows["sequence"][0] <= sequence:
                index = int(np.searchsorted(rows["sequence"], sequence))
                if index < len(rows) and rows["sequence"][index] == sequence:
                    return float(rows["x_px"][index]), float(rows["y_px"][index])
                break
        return math.nan, math.nan

    def _plot_losses(self) -> None:
        self._last_losses = self.missing, self.lost
        self._losses_due_ns = self._last_ns + _LOSSES_INTERVAL_NS
        counts = {"missing_frames": self.missing, "lost_spots": self.lost}
        self._run_plot.losses(self._run_s(self._last_ns), counts)

    def _plot_state(self) -> None:
        self._state_due_ns = self._last_ns + _STATE_INTERVAL_NS
        self._run_plot.text(layout.STATE, self._run_s(self._last_ns), self._state())

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
