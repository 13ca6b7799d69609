"""A table: plain values for its CSV, and how a person reads it."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

Cell = float | int | str


@dataclass(frozen=True)
class Table:
    """`columns` and `rows` go into the CSV as they are; `head` and `shown` are what a person reads.

    `shown` empty: the table is a file alone (too long to print).
    """

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    head: Sequence[str] = ()
    shown: Sequence[Sequence[str]] = ()
    note: str = ""

    def csv(self) -> str:
        """Comma-separated, one header line, numbers to the last digit; NaN is an empty cell."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        for row in self.rows:
            writer.writerow(["" if isinstance(v, float) and math.isnan(v) else v for v in row])
        return out.getvalue()
