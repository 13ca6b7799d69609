"""Tables of reports on the terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table as RichTable

from rig.presentation.table import Table


def print_tables(tables: Sequence[Table]) -> None:
    """The tables on the terminal, as wide as they need."""
    console = Console(width=None if Console().is_terminal else 170)
    for content in tables:
        drawn = RichTable(title=content.title, title_justify="left", box=None, pad_edge=False)
        for place, cell in enumerate(content.head):
            drawn.add_column(cell, justify="left" if place in (0, 1, len(content.head) - 1) else "right")
        for row in content.shown:
            drawn.add_row(*row)
        console.print(drawn)
        if content.note:
            console.print(content.note, highlight=False, markup=False)
        console.print()
