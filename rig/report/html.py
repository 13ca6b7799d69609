"""One self-contained HTML page: no script, no font, no file beside it; figures inside as data."""

import base64
import html
import re
from collections.abc import Sequence
from pathlib import Path

from acquisition.record.check import Finding
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.presentation import Table
from rig.report.drawing import ReportFigure

RESULTS_SHA256 = "results-sha256"
STYLE = """
:root { --ink: #1f2630; --soft: #5b6675; --line: #d9dee5; --tint: #f5f7fa; --accent: #0072b2; }
* { box-sizing: border-box; }
html { font: 15px/1.55 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; color: var(--ink);
  background: #fff; -webkit-print-color-adjust: exact; print-color-adjust: exact; }
body { max-width: 60rem; margin: 0 auto; padding: 2.4rem 1.6rem 4rem; }
header { border-bottom: 2px solid var(--ink); padding-bottom: .9rem; margin-bottom: 1.4rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .3rem; letter-spacing: -.01em; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .8rem; padding-top: .5rem; border-top: 1px solid var(--line); }
h3 { font-size: 1.02rem; margin: 1.9rem 0 .5rem; }
p { margin: .5rem 0; max-width: 46rem; }
.soft, figcaption, .note { color: var(--soft); font-size: .88rem; }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(17.5rem, 1fr)); gap: .7rem;
  margin: 1.1rem 0; }
.key div { background: var(--tint); border-left: 3px solid var(--accent); padding: .55rem .8rem; }
.key span { display: block; color: var(--soft); font-size: .8rem; }
.key b { font-weight: 600; font-size: 1rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; margin: .4rem 0; }
th { text-align: right; font-weight: 600; color: var(--soft); border-bottom: 1.5px solid var(--ink);
  padding: .22rem .6rem; vertical-align: bottom; }
td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: .2rem; }
td:first-child { white-space: normal; max-width: 12rem; }
.side { display: flex; flex-wrap: wrap; gap: 0 3rem; align-items: flex-start; }
header + h2 { border-top: 0; margin-top: 0; }
table.verdict td:last-child { white-space: normal; min-width: 8rem; text-align: left; }
table.verdict th:last-child { text-align: left; }
table.verdict td:nth-child(2) { text-align: left; }
tr.group td { border-top: 1px solid #9aa5b1; }
figure { margin: 1.3rem 0 1.6rem; }
figure img { width: 100%; height: auto; display: block; }
figcaption { margin-top: .25rem; max-width: 46rem; }
figcaption b { color: var(--ink); font-weight: 600; }
ul.notes { padding-left: 1.1rem; margin: .6rem 0; }
ul.notes li { margin: .25rem 0; }
.warn { border-left: 3px solid #d55e00; background: #fdf3ec; padding: .5rem .9rem; margin: .8rem 0; }
table.facts td { white-space: normal; text-align: left; overflow-wrap: anywhere; }
table.facts td:first-child { color: var(--soft); vertical-align: top; min-width: 8rem; max-width: 15rem; }
.columns { columns: 2; column-gap: 2rem; }
.columns table { width: 100%; font-size: .76rem; }
@media (max-width: 44rem) { .columns { columns: 1; } }
@page { size: A4; margin: 15mm 14mm; }
@media print {
  html { font-size: 10.2px; }
  body { max-width: none; padding: 0; }
  h2 { break-after: avoid; }
  h2.page { break-before: page; border-top: 0; }
  h3 { break-after: avoid; }
  figure, .key, tr, .warn { break-inside: avoid; }
  table.short { break-inside: avoid; }
  .scroll { overflow: visible; }
  thead { display: table-header-group; }
}
"""


def page(title: str, subtitle: str, body: Sequence[str], results_sha256: str = "") -> str:
    """The whole page; it states the SHA-256 of the results that it was made from."""
    made_from = f'<meta name="{RESULTS_SHA256}" content="{results_sha256}">' if results_sha256 else ""
    return (
        "<!DOCTYPE html>\n"
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{made_from}"
        f"<style>{STYLE}</style></head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><p class="soft">{escape(subtitle)}</p></header>\n'
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def escape(text: str) -> str:
    """Text as it may stand between tags."""
    return html.escape(text, quote=True)


def heading(text: str, level: int = 2, *, new_page: bool = False) -> str:
    """A heading; `new_page` where paper should turn over."""
    kind = ' class="page"' if new_page else ""
    return f"<h{level}{kind}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    attribute = f' class="{kind}"' if kind else ""
    return f"<p{attribute}>{escape(text)}</p>"


def picture(drawing: ReportFigure, data: bytes, kind: str) -> str:
    """A figure with its caption; `kind` is the media type of the data."""
    encoded = base64.b64encode(data).decode("ascii")
    return (
        f'<figure><img alt="{escape(drawing.title)}" src="data:{kind};base64,{encoded}">'
        f"<figcaption><b>{escape(drawing.title)}.</b> {escape(drawing.caption)}</figcaption></figure>"
    )


def table(content: Table, level: int = 3) -> str:
    """A table with its title and note."""
    short = ' class="short"' if len(content.shown) < 20 else ""
    if content.head and content.head[-1] == "verdict":
        short = short.replace('class="short', 'class="short verdict') or ' class="verdict"'
    head = "".join(f"<th>{escape(cell)}</th>" for cell in content.head)
    lines = []
    grouped = len({row[0] for row in content.shown if row[0]}) < len(content.shown)
    for row in content.shown:
        group = ' class="group"' if grouped and row[0] else ""
        lines.append(f"<tr{group}>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
    note = paragraph(content.note, "note") if content.note else ""
    header = f"<thead><tr>{head}</tr></thead>" if any(content.head) else ""
    return (
        f"{heading(content.title, level)}\n"
        f'<div class="scroll"><table{short}>{header}<tbody>{"".join(lines)}</tbody></table></div>{note}'
    )


def side_by_side(tables: Sequence[str]) -> str:
    """Small tables next to each other where the page is wide enough."""
    return '<div class="side">' + "".join(f"<div>{content}</div>" for content in tables) + "</div>"


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """Two columns of text."""
    lines = "".join(f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in rows)
    return f'<table class="facts"><tbody>{lines}</tbody></table>'


def notes(lines: Sequence[str]) -> str:
    """A list of remarks; nothing where there are none."""
    if not lines:
        return ""
    return '<ul class="notes">' + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def key_values(items: Sequence[tuple[str, str]]) -> str:
    """The results that are looked for first, large."""
    return (
        '<div class="key">'
        + "".join(f"<div><span>{escape(name)}</span><b>{escape(value)}</b></div>" for name, value in items)
        + "</div>"
    )


def stated_results_sha256(text: str) -> str:
    """SHA-256 of the results that a page says it was made from; empty if it says none."""
    found = re.search(f'<meta name="{RESULTS_SHA256}" content="([0-9a-f]{{64}})">', text)
    return found[1] if found else ""


def check_report(results: Path) -> list[Finding]:
    """Compare the SHA-256 in the report of a results file with the file; nothing without a report."""
    report = results.with_name(results.stem.replace("results", "report", 1) + ".html")
    if not report.is_file():
        return []
    try:
        stated = stated_results_sha256(report.read_text(encoding="utf-8", errors="replace"))
    except OSError as error:
        raise RecordError(f"{report}: cannot be read: {error.strerror or error}") from None
    if not stated:
        return [Finding("note", f"{report.name} does not say which results it was made from")]
    if stated != sha256_of(results):
        return [
            Finding("error", f"{report.name} was made from other results than {results.name}; run rig report")
        ]
    return [Finding("note", f"{report.name} was made from {results.name}")]
