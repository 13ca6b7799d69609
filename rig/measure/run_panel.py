"""The screen of a run as it is laid out on the terminal: phase, bar, numbers, estimates, last events."""

import time
from collections import deque
from collections.abc import Sequence

from rich.console import ConsoleDimensions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from processing.estimate import Estimate
from rig.instrument import Snapshot
from rig.presentation import loud, percent, quantity
from rig.settings import StopCondition

_TWO_COLUMNS_FROM = 120
_MOST_NOTES = 10


def run_panel(
    title: str,
    snapshot: Snapshot,
    done: float,
    rows: Sequence[tuple[str, str]],
    notes: Sequence[str],
    size: ConsoleDimensions,
) -> Panel:
    """A panel no wider and no higher than the terminal's `size`.

    `done` is the part of the run that is over, for the bar. Of `notes` as many of the last are shown as fit.
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
        Text.assemble((f"{title}  ", "bold"), (snapshot.doing, "bold cyan"), no_wrap=True),
        _bar(done, width - 4),
        table,
    ]
    if snapshot.alarm:
        parts.insert(0, Text(f"!!! {snapshot.alarm.upper()} !!!", style="bold white on red"))
    if snapshot.instruction:
        parts.append(Text(f">>> {loud(snapshot.instruction)} <<<", style="bold reverse"))
    used = 4 + (len(rows) + 1) // 2 if wide else 4 + len(rows)
    room = max(1, min(_MOST_NOTES, height - used - 3 - bool(snapshot.instruction) - bool(snapshot.alarm)))
    parts += [Text(note, style="dim", no_wrap=True, overflow="ellipsis") for note in notes[-room:]]
    return Panel(Group(*parts), width=width - 1, padding=(0, 1))


def _bar(part: float, width: int) -> Text:
    room = max(width - 8, 10)
    full = round(part * room)
    rest = ("━" * (room - full), "bright_black")
    return Text.assemble(("━" * full, "green"), rest, f" {100 * part:3.0f} %")


class Rates:
    """Frames and bytes per second over the last few seconds of the host's time."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque(maxlen=50)

    def take(self, snapshot: Snapshot) -> None:
        """Note the counts; fewer frames than before are those of another phase, which starts again."""
        if self._points and snapshot.frames < self._points[-1][1]:
            self._points.clear()
        self._points.append((time.monotonic(), snapshot.frames, snapshot.record_bytes))

    @property
    def frames_hz(self) -> float:
        return self._rate(1)

    @property
    def bytes_per_s(self) -> float:
        return self._rate(2)

    def _rate(self, column: int) -> float:
        if len(self._points) < 2:
            return 0.0
        first, last = self._points[0], self._points[-1]
        return float(last[column] - first[column]) / max(last[0] - first[0], 1e-9)


_SHOWN_FROM = 1.0
"""Relative uncertainty below which a value means something."""


def estimate_rows(snapshot: Snapshot, stop_when: Sequence[StopCondition]) -> list[tuple[str, str]]:
    """Two parameters a row, and what the end of the run waits for; no row before the first fit."""
    found, keys = snapshot.estimates, list(snapshot.estimates)
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
