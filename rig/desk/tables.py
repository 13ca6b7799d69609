"""Tables of the desk, lists, and bars against limits, as HTML text; files of the page that are not Python."""

import html
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

_STATIC = Path(__file__).with_name("static")


@cache
def static(*names: str) -> str:
    """The text of some files of `static`, one after the other; read once, because a disk may hang later."""
    return "".join((_STATIC / name).read_text("utf-8") for name in names)


def span(text: str, kind: str = "", tag: str = "span") -> str:
    """A text in an element of a class, which may be a kind of verdict: go, no, caution or dim."""
    return f"<{tag} class='{kind}'>{html.escape(text)}</{tag}>" if text else ""


def table(rows: Sequence[Sequence[str]], label: str) -> str:
    """A table of text; the first cell of each row is its heading."""
    lines = [
        f"<tr><th scope='row'>{html.escape(row[0])}</th>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    ]
    return f"<table class='rows' aria-label='{html.escape(label)}'>{''.join(lines)}</table>"


class LimitBar(NamedTuple):
    """A number beside its limit, as a bar.

    `part` and `limit_part` are the number and its limit as parts of the full bar; `part` is None for an
    unknown number. `kind` is the class of its colour: go, no, caution or dim. `shown` is the number as text,
    `note` a remark below it.
    """

    name: str
    shown: str
    part: float | None
    limit_part: float | None
    kind: str
    note: str = ""


def bars(rows: Sequence[LimitBar], label: str) -> str:
    """Bars one below the other; a screen reader reads name, number and note of each."""
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
