"""Tables of the desk, and bars against limits, as HTML text."""

import html
import math
from collections.abc import Sequence
from typing import NamedTuple


def table(rows: Sequence[Sequence[str]], label: str) -> str:
    """A table of text whose first column names the rest."""
    lines = [
        f"<tr><th scope='row'>{html.escape(row[0])}</th>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    ]
    return f"<table class='rows' aria-label='{html.escape(label)}'>{''.join(lines)}</table>"


class LimitBar(NamedTuple):
    """A number against its limit: both as parts of a full bar, `part` None where it is not known.

    `kind` is go, no, caution or dim; `shown` the number in words, `note` what more is to be said.
    """

    name: str
    shown: str
    part: float | None
    limit_part: float | None
    kind: str
    note: str = ""


def bars(rows: Sequence[LimitBar], label: str) -> str:
    """Bars below each other; who does not see them reads name, number and note."""
    lines = []
    for row in rows:
        filled = 0.0 if row.part is None else 100 * min(max(abs(row.part), 0.0), 1.0)
        limit = "" if row.limit_part is None else f"<b style='left: {100 * row.limit_part:.1f}%'></b>"
        lines.append(
            f"<span>{html.escape(row.name)}</span><span class='track {row.kind}'>"
            f"<i style='width: {filled:.1f}%'></i>{limit}</span>"
            f"<span class='{row.kind}'>{html.escape(row.shown)}</span>"
            + (f"<span class='note'>{html.escape(row.note)}</span>" if row.note else "")
        )
    return f"<div class='against' role='group' aria-label='{html.escape(label)}'>{''.join(lines)}</div>"


def against_limit(value: float | None, limit: float) -> tuple[float | None, float]:
    """A number and its limit as parts of a bar whose end is three times the limit, or the number."""
    if value is None or not math.isfinite(value):
        return None, 1 / 3
    end = max(3 * limit, abs(value)) or 1.0
    return abs(value) / end, limit / end
