"""One self-contained HTML page: no script, no font, no other file; figures are embedded as data."""

import base64
import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from acquisition import atomic_write
from acquisition.record.check import Finding
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.report.drawing import DATA, INK, ReportFigure, png, svg
from rig.terminal import Table, palette

RESULTS_SHA256 = "results-sha256"
LIGHT: Final[Mapping[str, str]] = {
    "paper": "#ffffff", "ink": INK, "soft": "#566070", "line": "#d9dee5", "tint": "#f4f6f9",
    "accent": palette.BLUE, "warn": "#fdf3ec", "good": "#006b4e", "bad": "#a83f00", "card": "#ffffff",
}  # fmt: skip
DARK: Final[Mapping[str, str]] = {
    "paper": "#12161c", "ink": "#e3e8ee", "soft": "#aab5c2", "line": "#38424e", "tint": "#1c232c",
    "accent": palette.SKY_BLUE, "warn": "#34241a", "good": "#3fcf9f", "bad": "#ff9a5c", "card": "#f4f6f9",
}  # fmt: skip
_DARK_COLOUR: Final = {INK: DARK["ink"], "#ffffff": DARK["paper"], "#000000": DARK["ink"], DATA: "#7cc4f0"}
"""Colours of figures that are invisible on a dark ground, with their substitutes; the others stay."""


def variables(theme: Mapping[str, str]) -> str:
    """The colours as custom properties of CSS."""
    return " ".join(f"--{name}: {colour};" for name, colour in theme.items())


STYLE = (
    f"""
:root {{ color-scheme: light; {variables(LIGHT)} }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ color-scheme: dark; {variables(DARK)} }} }}
"""
    """
* { box-sizing: border-box; }
html { font: 15px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; color: var(--ink);
  background: var(--paper); -webkit-print-color-adjust: exact; print-color-adjust: exact; }
body { background: var(--paper); max-width: 72rem; margin: 0 auto; padding: 1.2rem 1.6rem 4rem; }
header { border-bottom: 2px solid var(--ink); padding-bottom: .5rem; margin-bottom: .8rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .2rem; letter-spacing: -.01em; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .8rem; padding-top: .5rem; border-top: 1px solid var(--line); }
h3 { font-size: 1.02rem; margin: 1.9rem 0 .5rem; }
p { margin: .5rem 0; max-width: 46rem; }
pre { background: var(--tint); padding: .5rem .8rem; font-size: .8rem; white-space: pre-wrap; }
a { color: var(--accent); }
.soft, figcaption, .note { color: var(--soft); font-size: .88rem; }
.first { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1.05fr); gap: 0 1.6rem; }
.first figure, .first .key { margin: .2rem 0; }
.verdict { list-style: none; padding: 0; margin: 0 0 .7rem; }
.verdict li { margin: .15rem 0; }
.verdict li:first-child { font-size: 1.3rem; font-weight: 600; line-height: 1.3; }
.good { color: var(--good); }
.bad { color: var(--bad); font-weight: 600; }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(14rem, 1fr)); gap: .5rem;
  margin: 1.1rem 0; }
.key div { background: var(--tint); border-left: 3px solid var(--accent); padding: .35rem .7rem; }
.key span { display: block; color: var(--soft); font-size: .8rem; line-height: 1.35; }
.key b { font-weight: 600; font-size: 1rem; font-variant-numeric: tabular-nums; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; margin: .4rem 0; }
thead th, thead td { text-align: right; font-weight: 600; color: var(--soft); padding: .22rem .6rem;
  border-bottom: 1.5px solid var(--ink); vertical-align: bottom; }
td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: .2rem; }
td:first-child { white-space: normal; max-width: 12rem; }
.side { display: flex; flex-wrap: wrap; gap: 0 3rem; align-items: flex-start; }
.side > div { max-width: 100%; }
table.verdict td:last-child { white-space: normal; min-width: 8rem; text-align: left; }
table.verdict th:last-child { text-align: left; }
table.verdict td:nth-child(2) { text-align: left; }
tr.group td { border-top: 1px solid var(--soft); }
figure { margin: 1.3rem 0 1.6rem; max-width: 60rem; }
figure img { width: 100%; height: auto; display: block; }
figure img.card { background: var(--card); border-radius: 3px; }
figcaption { margin-top: .25rem; max-width: 46rem; }
figcaption b { color: var(--ink); font-weight: 600; }
ul.notes { padding-left: 1.1rem; margin: .6rem 0; max-width: 60rem; }
ul.notes li { margin: .25rem 0; }
.warn { border-left: 3px solid #d55e00; background: var(--warn); padding: .35rem .9rem; margin: .6rem 0; }
table.facts td { white-space: normal; text-align: left; overflow-wrap: anywhere; }
table.facts td:first-child { color: var(--soft); vertical-align: top; min-width: 8rem; max-width: 15rem; }
details { margin: .8rem 0; }
summary { cursor: pointer; font-weight: 600; padding: .2rem 0; }
.columns { columns: 2; column-gap: 2rem; }
.columns table { width: 100%; font-size: .76rem; }
@media (max-width: 56rem) { .first { grid-template-columns: minmax(0, 1fr); } }
@media (max-width: 44rem) { .columns { columns: 1; } body { padding: 1rem 1rem 3rem; } }
@page { size: A4; margin: 15mm 14mm; }
@media print {
  html { font-size: 10.2px; }
  body { max-width: none; padding: 0; }
  .first { grid-template-columns: minmax(0, 1fr) minmax(0, 1.05fr); }
  h2 { break-after: avoid; }
  h3 { break-after: avoid; }
  figure, .key, tr, .warn { break-inside: avoid; }
  figure { max-width: 125mm; }
  table.short { break-inside: avoid; }
  .scroll { overflow: visible; }
  thead { display: table-header-group; }
  details::details-content { display: none; }
  details > :not(summary) { display: none; }
}
"""
)


def page(title: str, subtitle: str, body: Sequence[str], results_sha256: str = "") -> str:
    """The whole page; its head states the SHA-256 of the results that it was made from."""
    made_from = f'<meta name="{RESULTS_SHA256}" content="{results_sha256}">' if results_sha256 else ""
    return (
        "<!DOCTYPE html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{made_from}"
        f"<style>{STYLE}</style></head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><p class="soft">{escape(subtitle)}</p></header>\n<main>\n'
        + "\n".join(body)
        + "\n</main></body></html>\n"
    )


def escape(text: str) -> str:
    """Text with the characters of HTML's syntax escaped."""
    return html.escape(text, quote=True)


def heading(text: str, level: int = 2) -> str:
    """A heading."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    attribute = f' class="{kind}"' if kind else ""
    return f"<p{attribute}>{escape(text)}</p>"


def picture(drawing: ReportFigure, data: bytes, kind: str) -> str:
    """A figure with its caption; `kind` is the media type of the data.

    Line drawings follow the page's theme; figures that contain pixels stay on white.
    """
    themed = kind == "image/svg+xml" and b"<image" not in data
    if kind == "image/svg+xml":
        text = (with_theme(data) if themed else data).decode().replace("\n", " ").replace('"', "'")
        # escaped, because an address ends at a `#`; base64 would be a third longer
        for mark in "%#&":
            text = text.replace(mark, f"%{ord(mark):X}")
        source = f"data:{kind},{text}"
    else:
        source = f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
    card = "" if themed else ' class="card"'
    return (
        f'<figure><img{card} alt="{escape(drawing.title)}" src="{source}">'
        f"<figcaption><b>{escape(drawing.title)}.</b> {escape(drawing.caption)}</figcaption></figure>"
    )


def table(content: Table, level: int = 3) -> str:
    """A table with its title and note."""
    short = ' class="short"' if len(content.shown) < 20 else ""
    if content.head and content.head[-1] == "verdict":
        short = short.replace('class="short', 'class="short verdict') or ' class="verdict"'
    # an empty heading is an empty cell, not a header
    head = "".join(f'<th scope="col">{escape(cell)}</th>' if cell else "<td></td>" for cell in content.head)
    lines = []
    grouped = len({row[0] for row in content.shown if row[0]}) < len(content.shown)
    for row in content.shown:
        group = ' class="group"' if grouped and row[0] else ""
        lines.append(f"<tr{group}>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
    note = paragraph(content.note, "note") if content.note else ""
    header = f"<thead><tr>{head}</tr></thead>" if any(content.head) else ""
    return (
        f"{heading(content.title, level)}\n"
        f'<div class="scroll" tabindex="0" role="group" aria-label="{escape(content.title)}">'
        f"<table{short}>{header}<tbody>{''.join(lines)}</tbody></table></div>{note}"
    )


def verdict(lines: Sequence[tuple[str, str]]) -> str:
    """Lines, each with its class (`good`, `bad` or none), the first one large."""
    items = "".join(
        f'<li class="{kind}">{escape(text)}</li>' if kind else f"<li>{escape(text)}</li>"
        for text, kind in lines
    )
    return f'<ul class="verdict">{items}</ul>'


def folded_section(title: str, body: Sequence[str]) -> str:
    """A section that is closed until the reader opens it, and never printed."""
    return f"<details><summary>{escape(title)}</summary>{''.join(body)}</details>"


def side_by_side(tables: Sequence[str]) -> str:
    """Small tables next to each other where the page is wide enough."""
    inside = "".join(f"<div>{content}</div>" for content in tables if content)
    return f'<div class="side">{inside}</div>' if inside else ""


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """Two columns of text."""
    lines = "".join(f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in rows)
    return f'<table class="facts"><tbody>{lines}</tbody></table>'


def notes(lines: Sequence[str]) -> str:
    """A list of remarks; empty text without remarks."""
    if not lines:
        return ""
    return '<ul class="notes">' + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def key_values(items: Sequence[tuple[str, str]]) -> str:
    """The main results in large type, as (name, value)."""
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
    stated = re.search(f'<meta name="{RESULTS_SHA256}" content="([0-9a-f]{{64}})">', page_text)
    if stated is None:
        return [Finding("note", f"{report.name} does not say which results it was made from")]
    if stated[1] != sha256_of(results):
        return [
            Finding("error", f"{report.name} was made from other results than {results.name}; run rig report")
        ]
    return [Finding("note", f"{report.name} was made from {results.name}")]


def save_figures(drawings: Sequence[ReportFigure], files: Path) -> dict[str, str]:
    """Write every figure as a file, frames as PNG, others as SVG; returns the HTML of each by name."""
    atomic_write.take_away_leftovers(files)
    found = {}
    for drawing in drawings:
        is_frame = drawing.name.endswith("frame")
        data = png(drawing) if is_frame else svg(drawing)
        atomic_write.replace(files / f"{drawing.name}.{'png' if is_frame else 'svg'}", data)
        found[drawing.name] = picture(drawing, data, "image/png" if is_frame else "image/svg+xml")
    return found


def save_tables(tables: Sequence[Table], files: Path) -> None:
    """Write every table as CSV."""
    atomic_write.take_away_leftovers(files)
    for table in tables:
        atomic_write.replace(files / f"{table.name}.csv", table.csv().encode())


def with_theme(figure: bytes) -> bytes:
    """A line drawing (SVG) that takes the colours of a dark theme by itself, even as an image."""
    rules = [f"svg {{ fill: {DARK['ink']}; }}"]
    for light, dark in _DARK_COLOUR.items():
        for part in ("fill", "stroke"):
            rules.append(f'[style*="{part}: {light.lower()}"] {{ {part}: {dark} !important; }}')
    style = f"<style>@media (prefers-color-scheme: dark) {{ {' '.join(rules)} }}</style>"
    head, tag, rest = figure.partition(b"<defs>")
    return head + style.encode() + tag + rest
