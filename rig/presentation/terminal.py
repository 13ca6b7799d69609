"""Tables of reports on the terminal."""

import sys
from collections.abc import Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable

from rig.presentation.json_object import answer
from rig.presentation.printing import Table, columns_of, folded, print_line, unbroken_words

_NUMBERS_BEGIN_WITH = tuple("0123456789−-+(<>–")
_WIDE = 170
"""Columns of a file or a pipe."""
_GAP = 2
"""Between columns; rich counts it behind the last one, too."""


def screen_width() -> int:
    """Columns of the terminal, or of what a table takes where nobody looks at one."""
    return columns_of(sys.stdout) or _WIDE


def print_tables(tables: Sequence[Table]) -> None:
    """Print tables; columns that consist mostly of numbers are right-aligned.

    Numbers are never broken, texts only between words; columns that do not fit beside each other follow
    below, with the first column again.
    """
    answer(tables=list(tables))
    width = screen_width()
    console = Console(width=width, markup=False)
    for content in tables:
        title = content.title
        for places in _parts(content, width):
            console.print(_drawn(content, title, places, width))
            title = ""
        if content.note:
            print_line(content.note)
        console.print()


def _parts(content: Table, width: int) -> list[list[int]]:
    """The places of the columns that stand beside each other, the first column in every part."""
    least = _least_widths(content)
    if not least:
        return []
    parts = [[0]]
    for place in range(1, len(least)):
        used = sum(least[one] + _GAP for one in parts[-1])
        if len(parts[-1]) > 1 and used + least[place] + _GAP > width:
            parts.append([0])
        parts[-1].append(place)
    return parts


def _drawn(content: Table, title: str, places: Sequence[int], width: int) -> RichTable:
    least, widths = _least_widths(content), _natural_widths(content)
    while sum(widths[place] + _GAP for place in places) > width:
        can = [place for place in places if widths[place] > least[place]]
        if not can:
            break
        widths[max(can, key=lambda place: widths[place])] -= 1
    drawn = RichTable(title=title or None, title_justify="left", box=None, pad_edge=False)
    for place in places:
        drawn.add_column(
            content.head[place],
            justify="right" if _is_of_numbers(content, place) else "left",
            width=widths[place],
        )
    for row in content.shown:
        drawn.add_row(*(_folded(row[place], widths[place]) for place in places))
    return drawn


def _folded(cell: str, width: int) -> str:
    return "\n".join(folded(line, width) for line in cell.split("\n"))


def _is_of_numbers(content: Table, place: int) -> bool:
    return 2 * sum(row[place].startswith(_NUMBERS_BEGIN_WITH) for row in content.shown) > len(content.shown)


def _natural_widths(content: Table) -> list[int]:
    return [
        max(map(cell_len, (heading, *(row[place] for row in content.shown))), default=0)
        for place, heading in enumerate(content.head)
    ]


def _least_widths(content: Table) -> list[int]:
    """So that no word is broken, and of a column of numbers no cell."""
    found = []
    for place, heading in enumerate(content.head):
        cells = [row[place] for row in content.shown]
        lines = [line for cell in cells for line in cell.split("\n")]
        whole = (
            cells if _is_of_numbers(content, place) else [w for line in lines for w in unbroken_words(line)]
        )
        found.append(max(map(cell_len, (*whole, *heading.split())), default=0))
    return found
