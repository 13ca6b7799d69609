"""Parts of a self-contained HTML page, without script or font; its figures; the check of its results."""

import base64
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape as escape
from pathlib import Path
from typing import Final

from acquisition import atomic_write
from acquisition.record.check import Finding
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.report.drawing import INK, ReportFigure, png, styled, svg
from rig.terminal import Table, palette

RESULTS_SHA256 = "results-sha256"
"""Name of the page's meta element with the SHA-256 of the results."""
_MIN_LONG_TABLE = 20
"""Lines from which on a table is long, and may be broken between pages."""
_STYLE: Final = Path(__file__).with_name("report.css")
"""Style sheet of a page."""
COLOURS: Final[Mapping[str, str]] = {
    "paper": "#ffffff", "ink": INK, "soft": "#566070", "line": "#d9dee5", "tint": "#f4f6f9",
    "accent": palette.BLUE, "warn": "#fdf3ec", "good": "#006b4e", "bad": "#a83f00",
}  # fmt: skip
"""Colours of the style sheet, by the names of their custom properties."""


def page(title: str, subtitle: str, body: Sequence[str], results_sha256: str = "") -> str:
    """The whole page; its head states the SHA-256 of the results that it was made from."""
    colours = " ".join(f"--{name}: {colour};" for name, colour in COLOURS.items())
    style = f":root {{ color-scheme: light; {colours} }}\n{_STYLE.read_text(encoding='utf-8')}"
    made_from = f'<meta name="{RESULTS_SHA256}" content="{results_sha256}">' if results_sha256 else ""
    return (
        "<!DOCTYPE html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{made_from}"
        f"<style>{style}</style></head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><p class="soft">{escape(subtitle)}</p></header>\n<main>\n'
        + "\n".join(body)
        + "\n</main></body></html>\n"
    )


def heading(text: str, level: int = 2) -> str:
    """A heading."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, css_class: str = "") -> str:
    """A paragraph of plain text."""
    attribute = f' class="{css_class}"' if css_class else ""
    return f"<p{attribute}>{escape(text)}</p>"


def warning(text: str) -> str:
    """A block of plain text with the colour of warnings."""
    return f'<div class="warn">{escape(text)}</div>'


def picture(drawing: ReportFigure, data: bytes, media_type: str) -> str:
    """A figure with its caption."""
    if media_type == "image/svg+xml":
        text = data.decode().replace("\n", " ").replace('"', "'")
        # a `#` would end the address, so it is escaped; base64, which has none, is a third longer
        for mark in "%#&":
            text = text.replace(mark, f"%{ord(mark):X}")
        source = f"data:{media_type},{text}"
    else:
        source = f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"
    return (
        f'<figure><img alt="{escape(drawing.title)}" src="{source}">'
        f"<figcaption><b>{escape(drawing.title)}.</b> {escape(drawing.caption)}</figcaption></figure>"
    )


def table(content: Table, level: int = 3) -> str:
    """A table with its title and note."""
    classes = ["short"] if len(content.shown) < _MIN_LONG_TABLE else []
    classes += ["verdict"] if content.head and content.head[-1] == "verdict" else []
    attribute = f' class="{" ".join(classes)}"' if classes else ""
    # an empty heading is an empty cell, not a header
    head = "".join(f'<th scope="col">{escape(cell)}</th>' if cell else "<td></td>" for cell in content.head)
    lines = []
    # rows without a first cell belong to the group of the row above
    has_groups = len({row[0] for row in content.shown if row[0]}) < len(content.shown)
    for row in content.shown:
        group = ' class="group"' if has_groups and row[0] else ""
        lines.append(f"<tr{group}>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
    note = paragraph(content.note, "note") if content.note else ""
    header = f"<thead><tr>{head}</tr></thead>" if any(content.head) else ""
    return (
        f"{heading(content.title, level)}\n"
        f'<div class="scroll" tabindex="0" role="group" aria-label="{escape(content.title)}">'
        f"<table{attribute}>{header}<tbody>{''.join(lines)}</tbody></table></div>{note}"
    )


def verdict_list(lines: Sequence[tuple[str, str]]) -> str:
    """A list of texts, each with its class (`good`, `bad` or empty); the first text is large."""
    items = "".join(
        f'<li class="{css_class}">{escape(text)}</li>' if css_class else f"<li>{escape(text)}</li>"
        for text, css_class in lines
    )
    return f'<ul class="verdict">{items}</ul>'


def folded_section(title: str, body: Sequence[str]) -> str:
    """A section that is closed until the reader opens it, and left out on paper."""
    return f"<details><summary>{escape(title)}</summary>{''.join(body)}</details>"


def two_columns(rows: Sequence[tuple[str, str]]) -> str:
    """A table of names and texts."""
    lines = "".join(f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in rows)
    return f'<table class="facts"><tbody>{lines}</tbody></table>'


def remark_list(lines: Sequence[str]) -> str:
    """A list of remarks; empty text without remarks."""
    if not lines:
        return ""
    return '<ul class="notes">' + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def headline_values(items: Sequence[tuple[str, str]]) -> str:
    """Names and values of the main results, in large type."""
    return (
        '<div class="key">'
        + "".join(f"<div><span>{escape(name)}</span><b>{escape(value)}</b></div>" for name, value in items)
        + "</div>"
    )


def check_report(results: Path) -> list[Finding]:
    """Compare the SHA-256 in the report of a results file with the file; no findings without a report."""
    report = results.with_name(results.stem.replace("results", "report", 1) + ".html")
    if not report.is_file():
        return []
    try:
        page_text = report.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RecordError(f"{report}: cannot be read: {error.strerror or error}") from None
    match = re.search(f'<meta name="{RESULTS_SHA256}" content="([0-9a-f]{{64}})">', page_text)
    if match is None:
        return [Finding("note", f"{report.name} does not say which results it was made from")]
    if match[1] != sha256_of(results):
        return [
            Finding("error", f"{report.name} was made from other results than {results.name}; run rig report")
        ]
    return [Finding("note", f"{report.name} was made from {results.name}")]


def save_figures(folder: Path, draw: Callable[[], Sequence[ReportFigure]]) -> dict[str, str]:
    """Write the figures that `draw` makes into a folder, which is made; returns the HTML of each by name."""
    folder.mkdir(parents=True, exist_ok=True)
    atomic_write.remove_leftovers(folder)
    figures = {}
    with styled():
        for drawing in draw():
            raster = drawing.is_raster
            data = png(drawing) if raster else svg(drawing)
            atomic_write.replace(folder / f"{drawing.name}.{'png' if raster else 'svg'}", data)
            figures[drawing.name] = picture(drawing, data, "image/png" if raster else "image/svg+xml")
    return figures
