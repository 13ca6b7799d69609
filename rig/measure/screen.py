"""Displays a run: a live screen on a terminal, otherwise a line every few seconds, or lines of JSON."""

import logging
import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from acquisition.record.events import EventKind
from processing.decay_summary import Forecast, forecast
from processing.deflections import DeflectionUnit
from processing.units import seconds
from rig.instrument import Phase, RecordContents, RunNow
from rig.measure.end_of_run import CONSECUTIVE_BELOW
from rig.measure.run_status import estimate_rows
from rig.settings import StopCondition
from rig.terminal import Verdict, decimals, loud, print_json_line, print_verdicts, say

_log = logging.getLogger(__name__)
_PLAIN_INTERVAL_S = 5.0
_JSON_INTERVAL_S = 1.0
_FORECAST_INTERVAL_S = 2.0
_MIN_FORECAST_HALF_CYCLES = 8
_MIN_RATES_SPAN_S = 5.0
"""Shortest span of the record over which rates are shown."""
_MAX_HALF_CYCLES = 20_000
_MAX_EVENTS = 10
_MIN_WIDTH_OF_TWO_COLUMNS = 120
_NO_FORECAST = Forecast(math.nan, math.nan)


@dataclass
class RunDisplay:
    """The display of one run. The run's thread only hands it values; the main thread draws the screen.

    The progress bar is linear in the logarithm of the amplitude, which decreases roughly evenly with time, or
    in time if the time limit will end the run.
    """

    title: str
    final_amplitude_arcsec: float
    unit: DeflectionUnit
    """Unit of amplitudes and positions."""
    _: KW_ONLY
    max_duration_s: float = math.inf
    """Longest duration of the record."""
    stop_when: Sequence[StopCondition] = ()
    """Conditions on the live fit that end the run."""
    json_lines: bool = False
    """Whether stdout gets lines of JSON."""
    simulated: bool = False
    phases: Sequence[Phase] = ()
    """Phases before the record."""
    console: Console = field(default_factory=partial(Console, stderr=True))

    def __post_init__(self) -> None:
        # the final amplitude is configured in arcsec, hence unknown in px
        self._final = self.final_amplitude_arcsec if self.unit is DeflectionUnit.RAD else math.nan
        self._initial = math.nan
        self._live: Live | None = None
        self._closed = False
        self._printed_s = 0.0
        self._phase: Phase | None = None
        self._demands = ("", "")
        self._turning_points: deque[tuple[float, float, float]] = deque(maxlen=_MAX_HALF_CYCLES)
        self._events: deque[str] = deque(maxlen=_MAX_EVENTS)
        self._to_print: deque[Callable[[], None]] = deque()
        self._counts: deque[tuple[float, int, int]] = deque()
        self._forecast = _NO_FORECAST
        self._forecast_due_s = 0.0

    def __enter__(self) -> Self:
        if self.console.is_terminal and not self.json_lines:
            self._live = Live(console=self.console, auto_refresh=False, transient=False)
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        if self._live is not None:
            with suppress(OSError):
                self._live.stop()

    def take(self, recorded: RecordContents) -> None:
        """Store turning points for the forecast, and the lines of events."""
        for half_cycle in recorded.half_cycles:
            if not half_cycle.flags:
                point = seconds(half_cycle.turn_time_ns), half_cycle.amplitude, half_cycle.u_amplitude
                self._turning_points.append(point)
        for event in recorded.events:
            elapsed_s = seconds(event.time_ns - recorded.start_ns)
            self._events.append(f"{elapsed_s:8.1f} s  {event.line}")
            if self.json_lines:
                line = {"elapsed_s": elapsed_s, "event": event.kind, "text": event.text}
                self._to_print.append(partial(self.line, "event", line))
            if event.kind == EventKind.REJECTED:
                self._to_print.append(partial(say, f"{self.title}: {event.text}"))

    def show_preflight(self, verdicts: Sequence[Verdict]) -> None:
        """Queue the preflight table for printing above the live screen."""
        rows = list(verdicts)
        if self.json_lines:
            self._to_print.append(lambda: self.line("preflight", {"table": rows}))
        else:
            self._to_print.append(lambda: print_verdicts(self.console, rows))

    def line(self, kind: str, values: dict[str, Any]) -> None:
        """Print one line of JSON on stdout; a closed stdout is ignored, so that the measurement continues."""
        try:
            print_json_line(kind, {"run": self.title, **values})
        except BrokenPipeError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, sys.stdout.fileno())
            os.close(null)

    def show(self, now: RunNow) -> None:
        """Update the display; fast enough to be called ten times a second.

        Lines of the processing thread are printed here, so that a blocked terminal delays no frame. Nothing
        more is printed once the terminal is closed.
        """
        if math.isnan(self._initial) and not math.isnan(now.amplitude):
            self._initial = now.amplitude
        now_s = time.monotonic()
        has_points = len(self._turning_points) >= _MIN_FORECAST_HALF_CYCLES
        if has_points and now_s >= self._forecast_due_s and not math.isnan(self._final):
            self._forecast_due_s = now_s + _FORECAST_INTERVAL_S
            self._forecast = self._predict_end()
        if self._closed:
            return
        try:
            self._print(now, now_s)
        except OSError as error:
            _log.warning("the display of the run failed, the run continues: %s", error)
            self._closed = True

    def _print(self, now: RunNow, now_s: float) -> None:
        while self._to_print:
            self._to_print.popleft()()
        demands = now.alarm, now.instruction
        changed = now.phase is not self._phase or demands != self._demands
        interval_s = _JSON_INTERVAL_S if self.json_lines else _PLAIN_INTERVAL_S
        if self._live is not None:
            self._live.update(self.screen(now), refresh=True)
        elif changed or now_s - self._printed_s >= interval_s:
            self._printed_s = now_s
            if self.json_lines:
                self.line("state", self.values(now))
            else:
                say(f"{self.title}: {100 * self._done_fraction(now):.0f} %  {self._plain_line(now)}")
            for demand in (now.alarm.upper(), loud(now.instruction)):
                if changed and demand and not self.json_lines:
                    say(f"{self.title}: {demand}")
        self._phase, self._demands = now.phase, demands

    def screen(self, now: RunNow) -> RenderableType:
        """The whole screen, cut to the size of the terminal; the newest events, as many as fit."""
        width, height = self.console.size
        title, rows = f"SIMULATED {self.title}" if self.simulated else self.title, self.rows(now)
        table = Table.grid(padding=(0, 1))
        columns = 2 if width >= _MIN_WIDTH_OF_TWO_COLUMNS else 1
        for _ in range(2 * columns):
            table.add_column(style="dim", no_wrap=True)
            table.add_column(no_wrap=True, overflow="ellipsis")
        height_of_rows = -(-len(rows) // columns)
        for k in range(height_of_rows):
            table.add_row(*(cell for row in rows[k::height_of_rows] for cell in row))
        parts: list[RenderableType] = [
            Text.assemble((f"{title}  ", "bold"), (now.phase_text, "bold cyan"), no_wrap=True),
            *([_phase_line(self.phases, now.phase)] if self.phases else []),
            _progress_bar(self._done_fraction(now), width - 4),
            table,
        ]
        if now.alarm:
            parts.insert(0, Text(f"!!! {now.alarm.upper()} !!!", style="bold white on red"))
        if now.instruction:
            parts.append(Text(f">>> {loud(now.instruction)} <<<", style="bold reverse"))
        # the table is one part of many lines; frame and terminal take some more
        max_events = max(1, height - len(parts) - height_of_rows - 4)
        for event in list(self._events)[-max_events:]:
            parts.append(Text(event, style="dim", no_wrap=True, overflow="ellipsis"))
        return Panel(Group(*parts), width=width - 1, padding=(0, 1))

    def values(self, now: RunNow) -> dict[str, Any]:
        """The state of the run for programs; the amplitude is in `amplitude_unit`."""
        remaining_s, u_s = self._forecast_of_end(now)
        frames_hz, bytes_per_s = self._rates(now)
        values = asdict(replace(now, balance=None))
        del values["balance"]
        values |= {
            "done": self._done_fraction(now),
            "remaining_s": remaining_s,
            "u_remaining_s": u_s,
            "at_most_s": self._time_to_limit_s(now),
            "no_swing_s": now.no_swing_s,
            "amplitude_unit": self.unit.shown,
            "frames_hz": frames_hz,
            "record_bytes_per_s": bytes_per_s,
        }
        if (balance := now.balance) is not None:
            values["transverse_ratio"] = balance.transverse_ratio
            values["line_angle_rad"] = balance.line_angle_rad
            values["rest_x"] = balance.rest_x / balance.unit.shown_size
            values["rest_y"] = balance.rest_y / balance.unit.shown_size
        return values

    def rows(self, now: RunNow) -> list[tuple[str, str]]:
        """Names and texts of the state, for people."""
        unit = self.unit.shown
        transverse = rest = "-"
        if (balance := now.balance) is not None:
            size, ratio, angle_rad = balance.unit.shown_size, balance.transverse_ratio, balance.line_angle_rad
            transverse = f"{balance.transverse / size:.3f} {balance.unit.shown} ({100 * ratio:.2f} %), "
            transverse += f"line {math.degrees(angle_rad):+.3f}°"
            x, y = (decimals(value / size, 3, sign=True) for value in (balance.rest_x, balance.rest_y))
            rest = f"X {x}, Y {y} {balance.unit.shown}"
        reasons = f" ({now.losses})" if now.losses.total else ""
        losses = f"{now.dropped_frames} frames dropped{reasons}, {now.lost_spots} spots lost"
        frames_hz, bytes_per_s = self._rates(now)
        age = "-" if math.isnan(now.frame_age_s) else f"{now.frame_age_s * 1e3:.0f} ms"
        camera = f"{frames_hz:.1f} frames/s, {now.frames} in all, age {age}"
        if now.precedes_record:
            losses = camera = "counted from the record on"
        rows = [
            ("elapsed", f"{_clock(now.elapsed_s)}, {now.half_cycles} half-cycles"),
            self._prediction(now),
            ("amplitude", _number(now.amplitude, ".3f", unit) + _age_of_amplitude(now)),
            ("period", _number(now.period_s, ".5f", "s")),
            *estimate_rows(now, self.stop_when),
            ("transverse", transverse),
            ("rest position", rest),
            ("camera", camera),
            ("clock", now.clock.text or "-"),
            ("beam", now.beam or "-"),
            ("losses", f"{losses}, {now.queue_frames} waiting"),
            ("record", f"{bytes_per_s / 1e6:.2f} MB/s, {now.record_bytes / 1e6:.1f} MB"),
            ("disk", _number(now.disk_free_bytes / 1e9, ".1f", "GB free")),
            ("environment", _air(now)),
        ]
        if now.controller:
            rows.append(("controller", now.controller))
        return rows

    def facts(self, now: RunNow) -> list[tuple[str, str]]:
        """The rows without those that a page shows elsewhere: amplitude, end, parameters."""
        hidden = {"amplitude", self._prediction(now)[0]}
        hidden |= {name for name, _ in estimate_rows(now, ())}
        return [row for row in self.rows(now) if row[0] not in hidden]

    def _time_to_limit_s(self, now: RunNow) -> float:
        """Time in s until the longest duration of the run, which counts from the start of the record."""
        if now.precedes_record:
            return self.max_duration_s
        return max(self.max_duration_s - now.elapsed_s, 0.0)

    def _forecast_of_end(self, now: RunNow) -> Forecast:
        """Time to the end of the run, by amplitude or time limit, whichever is first; NaN if unknown."""
        if now.precedes_record:
            return _NO_FORECAST
        limit_s = self._time_to_limit_s(now)
        # without a lever no amplitude ends the run
        is_limit = math.isnan(self._final) or self._forecast.remaining_s > limit_s
        return Forecast(limit_s, 0.0) if is_limit and math.isfinite(limit_s) else self._forecast

    def _prediction(self, now: RunNow) -> tuple[str, str]:
        """The row on the end of the run: which limit will end it, and the time left."""
        remaining_s, u_s = self._forecast_of_end(now)
        has_lever = not math.isnan(self._final)
        goal = f"to {self._final:g} {self.unit.shown}" if has_lever else "to the end"
        if math.isnan(remaining_s):
            limit_s = self._time_to_limit_s(now)
            limit = f", at most {_clock(limit_s)}" if math.isfinite(limit_s) else ""
            return goal, f"{'too early to say' if has_lever else 'unknown: no lever'}{limit}"
        end = time.strftime("%H:%M", time.localtime(time.time() + remaining_s))
        if u_s == 0:
            return "to the time limit", f"{_clock(remaining_s)}, at {end}"
        return goal, f"{_clock(remaining_s)} ± {_clock(u_s)}, at {end}"

    def _predict_end(self) -> Forecast:
        table = np.array(list(self._turning_points))
        final = self._final * self.unit.shown_size
        crossing = forecast(table[:, 0], table[:, 1], table[:, 2], final)
        # the run ends at the last of `CONSECUTIVE_BELOW` turning points below the limit, the first of which
        # may come up to one half-cycle after the amplitude has passed the limit
        half_period_s = float(np.median(np.diff(table[:, 0])))
        return Forecast(
            crossing.remaining_s + (CONSECUTIVE_BELOW - 0.5) * half_period_s,
            math.hypot(crossing.u_remaining_s, half_period_s / math.sqrt(12.0)),
        )

    def _rates(self, now: RunNow) -> tuple[float, float]:
        """Frames and bytes per second over the last seconds of the record; 0 before it begins."""
        counts = self._counts
        if now.precedes_record or (counts and now.frames < counts[-1][1]):
            counts.clear()
        if not now.precedes_record:
            counts.append((now.elapsed_s, now.frames, now.record_bytes))
        while len(counts) > 2 and now.elapsed_s - counts[1][0] >= _MIN_RATES_SPAN_S:
            counts.popleft()
        span_s = now.elapsed_s - counts[0][0] if counts else 0.0
        if span_s <= 0.0:
            return 0.0, 0.0
        return (now.frames - counts[0][1]) / span_s, (now.record_bytes - counts[0][2]) / span_s

    def _done_fraction(self, now: RunNow) -> float:
        if now.precedes_record:
            return 0.0
        time_fraction = min(now.elapsed_s / self.max_duration_s, 1.0)
        if not self._initial > self._final or math.isnan(now.amplitude):
            return time_fraction
        decay = math.log(self._initial / max(now.amplitude, self._final))
        return max(time_fraction, min(1.0, decay / math.log(self._initial / self._final)))

    def _plain_line(self, now: RunNow) -> str:
        amplitude = frames = ""
        if not math.isnan(now.amplitude):
            amplitude = f"{now.amplitude:7.2f} {self.unit.shown}{_age_of_amplitude(now)}  "
        # frames are counted from the record on
        if not now.precedes_record:
            frames = f"{now.frames} frames ({now.dropped_frames} dropped, {now.lost_spots} lost)"
        reason = f"  {now.reason}" if now.reason else ""
        phase = "" if now.phase is Phase.MEASURING else f"{now.phase_text}  "
        return f"{phase}t {now.elapsed_s:7.1f} s  {amplitude}{frames}{reason}".rstrip()


def _phase_line(phases: Sequence[Phase], now: Phase) -> Text:
    """All phases in order, the present one marked."""
    line = Text(no_wrap=True, overflow="ellipsis")
    for number, phase in enumerate((*phases, Phase.MEASURING)):
        line.append(" > " if number else "", "dim")
        name = "recording" if phase is Phase.MEASURING else phase.value
        line.append(name, "bold cyan" if phase is now else "dim")
    return line


def _progress_bar(done_fraction: float, width: int) -> Text:
    length = max(width - 8, 10)
    done = round(done_fraction * length)
    rest = ("━" * (length - done), "bright_black")
    return Text.assemble(("━" * done, "green"), rest, f" {100 * done_fraction:3.0f} %")


def _clock(duration_s: float) -> str:
    if not math.isfinite(duration_s):
        return "?"
    # rounded first, so that no minute has 60.0 s
    minutes, rest_s = divmod(round(max(duration_s, 0.0), 1), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{int(rest_s):02d}" if hours else f"{minutes}:{rest_s:04.1f}"


def _number(value: float, format_spec: str, unit: str) -> str:
    return "-" if math.isnan(value) else f"{value:{format_spec}} {unit}"


def _age_of_amplitude(now: RunNow) -> str:
    """How old the amplitude is, if it is older than it should be."""
    return f" (no swing for {now.no_swing_s:.0f} s)" if now.no_swing_s else ""


def _air(now: RunNow) -> str:
    if math.isnan(now.temperature_c):
        return "not measured"
    return f"{now.temperature_c:.2f} °C, {now.humidity_percent:.1f} %, {now.pressure_pa / 100:.1f} hPa"
