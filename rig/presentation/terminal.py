"""Tables of reports on the terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table as RichTable

from rig.presentation.json_object import answer
from rig.presentation.table import Table

_WIDTH_OF_FILES = 170
_NUMBERS_BEGIN_WITH = tuple("0123456789−-+(<>–")


def screen_width() -> int:
    """Columns of the terminal, or of what a table takes where nobody looks at one."""
    console = Console()
    return console.width if console.is_terminal else _WIDTH_OF_FILES


def print_tables(tables: Sequence[Table]) -> None:
    """Print tables; columns that consist mostly of numbers are right-aligned."""
    answer(tables=list(tables))
    console = Console(width=screen_width())
    for content in tables:
        drawn = RichTable(title=content.title, title_justify="left", box=None, pad_edge=False)
        for place, heading in enumerate(content.head):
            numbers = sum(row[place].startswith(_NUMBERS_BEGIN_WITH) for row in content.shown)
            drawn.add_column(heading, justify="right" if 2 * numbers > len(content.shown) else "left")
        for row in content.shown:
            drawn.add_row(*row)
        console.print(drawn)
        if content.note:
            console.print(content.note, highlight=False, markup=False)
        console.print()
