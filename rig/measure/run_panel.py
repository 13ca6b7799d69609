"""The screen of a run as it is laid out on the terminal: phase, bar, numbers, estimates, last events."""

import time
from collections import deque
from collections.abc import Sequence

from rich.console import ConsoleDimensions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from processing.estimate import Estimate
from rig.instrument import Phase, RunNow
from rig.presentation import loud, percent, quantity
from rig.settings import StopCondition

_TWO_COLUMNS_FROM = 120
_MOST_NOTES = 10
_RATES_S = 5.0


def run_panel(
    title: str,
    now: RunNow,
    done: float,
    rows: Sequence[tuple[str, str]],
    notes: Sequence[str],
    size: ConsoleDimensions,
    phases: Sequence[Phase] = (),
) -> Panel:
    """A panel no wider and no higher than the terminal's `size`.

    `done` is the part of the run that is over, for the bar, `phases` are those before the record. Of `notes`
    as many of the last are shown as fit.
    """
    width, height = size
    table = Table.grid(padding=(0, 1))
    wide = width >= _TWO_COLUMNS_FROM
    for _ in range(4 if wide else 2):
        table.add_column(style="dim", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis")
    if wide:
        half = (len(rows) + 1) // 2
        left, right = rows[:half], [*rows[half:], ("", "")]
        for k in range(half):
            table.add_row(*left[k], *right[k])
    else:
        for row in rows:
            table.add_row(*row)
    parts: list[RenderableType] = [
        Text.assemble((f"{title}  ", "bold"), (now.doing, "bold cyan"), no_wrap=True),
        *([_strip(phases, now.phase)] if phases else []),
        _bar(done, width - 4),
        table,
    ]
    if now.alarm:
        parts.insert(0, Text(f"!!! {now.alarm.upper()} !!!", style="bold white on red"))
    if now.instruction:
        parts.append(Text(f">>> {loud(now.instruction)} <<<", style="bold reverse"))
    used = 4 + (len(rows) + 1) // 2 if wide else 4 + len(rows)
    used += bool(phases) + bool(now.instruction) + bool(now.alarm)
    room = max(1, min(_MOST_NOTES, height - used - 3))
    parts += [Text(note, style="dim", no_wrap=True, overflow="ellipsis") for note in notes[-room:]]
    return Panel(Group(*parts), width=width - 1, padding=(0, 1))


def _strip(phases: Sequence[Phase], now: Phase) -> Text:
    """All phases in their order, the present one marked."""
    shown = Text(no_wrap=True, overflow="ellipsis")
    for place, phase in enumerate((*phases, Phase.MEASURING)):
        shown.append(" > " if place else "", "dim")
        name = "recording" if phase is Phase.MEASURING else phase.value
        shown.append(name, "bold cyan" if phase is now else "dim")
    return shown


def _bar(part: float, width: int) -> Text:
    room = max(width - 8, 10)
    full = round(part * room)
    rest = ("━" * (room - full), "bright_black")
    return Text.assemble(("━" * full, "green"), rest, f" {100 * part:3.0f} %")


class Rates:
    """Frames and bytes per second over the last few seconds of the host's time."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque()

    def take(self, now: RunNow) -> None:
        """Note counts that have changed; fewer frames than before are those of a record that begins again."""
        points, now_s = self._points, time.monotonic()
        if points and now.frames < points[-1][1]:
            points.clear()
        if not points or now.frames != points[-1][1]:
            points.append((now_s, now.frames, now.record_bytes))
        while len(points) > 2 and now_s - points[0][0] > _RATES_S:
            points.popleft()

    @property
    def frames_hz(self) -> float:
        return self._rate(1)

    @property
    def bytes_per_s(self) -> float:
        return self._rate(2)

    def _rate(self, column: int) -> float:
        if len(self._points) < 2 or time.monotonic() - self._points[-1][0] > _RATES_S:
            return 0.0
        first, last = self._points[0], self._points[-1]
        return float(last[column] - first[column]) / max(last[0] - first[0], 1e-9)


_SHOWN_FROM = 1.0
"""Relative uncertainty below which a value means something."""


def estimate_rows(now: RunNow, stop_when: Sequence[StopCondition]) -> list[tuple[str, str]]:
    """Two parameters a row, and what the end of the run waits for; no row before the first fit."""
    found, keys = now.estimates, list(now.estimates)
    rows = [
        (
            ", ".join(quantity(key).symbol for key in pair),
            ",  ".join(_text(key, found[key]) for key in pair),
        )
        for pair in (keys[first : first + 2] for first in range(0, len(keys), 2))
    ]
    if stop_when:
        rows.append(("ends when", ", ".join(condition.text(found) for condition in stop_when)))
    return rows


def estimate_texts(key: str, one: Estimate) -> tuple[str, str]:
    """Value with its uncertainty in the parameter's shown unit, and how large the uncertainty is beside it.

    A value that its uncertainty hides is not shown.
    """
    relative = one.standard_uncertainty / abs(one.value) if one.value else float("inf")
    if not relative < _SHOWN_FROM:
        return "not yet seen", ""
    return quantity(key).text(one.value, one.standard_uncertainty), percent(relative)


def _text(key: str, one: Estimate) -> str:
    value, relative = estimate_texts(key, one)
    return f"{value} {quantity(key).unit}".rstrip() + f" ({relative})" if relative else value
