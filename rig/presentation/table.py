"""A table: plain values for a CSV file, and texts for the user."""

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

Cell = float | int | str
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
_FORMULA_WITHIN = re.compile(r"([,;|](?:\s*(?=[=@]))?\"?)([=+@-])")
"""Behind what may part cells: a sign directly, = and @ also behind a blank or a quote."""


class Line(NamedTuple):
    """A line of a table: cells for the file, and texts for the user, none where it is only in the file."""

    cells: Sequence[Cell]
    shown: Sequence[str] = ()


@dataclass(frozen=True)
class Table:
    """Heading and values for the CSV file (`columns`, `rows`), and as text for the user (`head`, `shown`).

    If `shown` is empty, the table is only written to a file, because it is too long to print.
    """

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    head: Sequence[str] = ()
    shown: Sequence[Sequence[str]] = ()
    note: str = ""

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        columns: str | Sequence[str],
        head: Sequence[str],
        lines: Sequence[Line],
        note: str = "",
    ) -> "Table":
        """A table of lines; `columns` may be words in one text."""
        columns = columns.split() if isinstance(columns, str) else columns
        shown = [line.shown for line in lines if line.shown]
        return cls(name, title, columns, [line.cells for line in lines], head, shown, note)

    def csv(self) -> str:
        """Comma-separated values with one header line; numbers have all digits, NaN is an empty cell."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        for row in self.rows:
            writer.writerow([_cell(value) for value in row])
        return out.getvalue()


def harmless_text(text: str) -> str:
    """A text as the cell of a CSV file: one that a spreadsheet would take for a formula begins with ``'``."""
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def harmless_line(text: str) -> str:
    """A line of words above a CSV file's columns, which a spreadsheet splits into cells like any other.

    A cell that it would take for a formula begins with ``'``; JSON stays the same content, escaped.
    """
    if ": {" in text and text.endswith("}"):
        return _FORMULA_WITHIN.sub(lambda found: f"{found[1]}\\u{ord(found[2]):04x}", text)
    return _FORMULA_WITHIN.sub(r"\1'\2", text)


def _cell(value: Cell) -> Cell:
    if isinstance(value, str):
        return harmless_text(value)
    return "" if isinstance(value, float) and math.isnan(value) else value
