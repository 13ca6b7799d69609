"""The screen of a run as it is laid out on the terminal: phase, bar, numbers, instruction, last events."""

from collections.abc import Sequence

from rich.console import ConsoleDimensions, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from rig.instrument import Snapshot

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
        parts.append(Text(f">>> {snapshot.instruction.upper()} <<<", style="bold reverse"))
    used = 4 + (len(rows) + 1) // 2 if wide else 4 + len(rows)
    room = max(1, min(_MOST_NOTES, height - used - 3 - bool(snapshot.instruction) - bool(snapshot.alarm)))
    parts += [Text(note, style="dim", no_wrap=True, overflow="ellipsis") for note in notes[-room:]]
    return Panel(Group(*parts), width=width - 1, padding=(0, 1))


def _bar(part: float, width: int) -> Text:
    room = max(width - 8, 10)
    full = round(part * room)
    rest = ("━" * (room - full), "bright_black")
    return Text.assemble(("━" * full, "green"), rest, f" {100 * part:3.0f} %")
