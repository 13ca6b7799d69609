"""HTML of the desk: texts, tables, bars against limits, and the static files of the page."""

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
    """A number beside its limit, as a bar."""

    name: str
    text: str
    """The number as text."""
    fraction: float | None
    """The number as a fraction of the full bar; None if it is unknown."""
    limit_fraction: float | None
    """The limit as a fraction of the full bar; None without a limit."""
    kind: str
    """Class of its colour: go, no, caution or dim."""
    note: str = ""
    """A remark below it."""


def bars(rows: Sequence[LimitBar], label: str) -> str:
    """Bars one below the other; a screen reader reads name, number and note of each."""
    lines = []
    for row in rows:
        width = 0.0 if row.fraction is None else 100 * min(abs(row.fraction), 1.0)
        limit = "" if row.limit_fraction is None else f"<b style='left: {100 * row.limit_fraction:.1f}%'></b>"
        lines.append(
            f"<span>{html.escape(row.name)}</span><span class='track {row.kind}'>"
            f"<i style='width: {width:.1f}%'></i>{limit}</span>"
            f"<span class='{row.kind}'>{html.escape(row.text)}</span>"
            + (f"<span class='note'>{html.escape(row.note)}</span>" if row.note else "")
        )
    return f"<div class='against' role='group' aria-label='{html.escape(label)}'>{''.join(lines)}</div>"


def against_limit(value: float | None, limit: float) -> tuple[float | None, float]:
    """A number and its limit as fractions of a bar that ends at three times the limit, or at the number."""
    if value is None or not math.isfinite(value):
        return None, 1 / 3
    end = max(3 * limit, abs(value)) or 1.0
    return abs(value) / end, limit / end
