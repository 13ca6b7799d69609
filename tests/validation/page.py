"""The page: every row with its number, its limit and when it was measured; bold is what falls short."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.validation.kept import ROOT, Kept
from tests.validation.row import NotTested, Row

FILE = ROOT / "docs" / "validation.md"
_HEAD = """# Validation

How far the numbers of this program can be trusted. Each row is a claim, tested by means that share nothing
with the code: certified values, a standard, published data, another program, or a simulation without a
formula of the analysis. **Bold** falls short of its limit. A share of cases has as its limit three binomial
standard deviations about 68 %, if nothing else is said. `docs/validation.json` keeps the numbers, each
with the commit that it was measured on.

    make validation                         # rows that this commit has no number of; about two hours
    make validation ARGS="--quick"          # rows that take seconds
    make validation ARGS="gum iso11146"     # those whose names begin like that
    make validation ARGS="--again gum-h1"   # also if this commit has a number

Other programs come with `pip install -e ".[bench]"`, public data from the folder `RIG_SHARED_DATA`.
"""
_FIGURE = (
    "![Shares of cases that intervals hold, for each fit](pictures/validation-coverage.svg)",
    "",
    (
        "How often an interval of one standard uncertainty holds the truth: a point is a parameter of a "
        "case, or all of a case together; the band is the row's limit, the line 68 %, which is right."
    ),
    "",
)


def page_of(rows: Sequence[Row], kept: Mapping[str, Kept], not_tested: Sequence[NotTested]) -> str:
    """The whole page, in Markdown."""
    text = [_HEAD, summary(rows, kept), ""]
    if any(row.share and row.name in kept for row in rows):
        text += _FIGURE
    for group in dict.fromkeys(row.group for row in rows):
        text += [
            f"## {group}",
            "",
            "| row | claim | tested by | number | limit | measured |",
            "|---|---|---|---|---|---|",
            *(_line(row, kept.get(row.name)) for row in rows if row.group == group),
            "",
        ]
    text += ["## What has no row", "", "| what | why |", "|---|---|"]
    text += [f"| {item.what} | {item.why} |" for item in not_tested]
    return "\n".join([*text, "", _machines(rows, kept)]) + "\n"


def summary(rows: Sequence[Row], kept: Mapping[str, Kept]) -> str:
    """How many rows keep their limit, fall short, were not run."""
    run = [row for row in rows if row.name in kept]
    short = [row for row in run if not row.limit.holds(kept[row.name].values)]
    names = f" ({', '.join(f'`{row.name}`' for row in short)})" if short else ""
    return (
        f"{len(rows)} rows: {len(run) - len(short)} within their limits, {len(short)} short of them{names}, "
        f"{len(rows) - len(run)} not run on this commit."
    )


def shown(row: Row, found: Kept) -> str:
    """The number with its unit, bold where it is beyond the limit."""
    low, high = min(found.values), max(found.values)
    number = f"{low:.3g}" if len(found.values) == 1 or low == high else f"{low:.3g} to {high:.3g}"
    text = f"{number} {row.unit}".strip()
    return text if row.limit.holds(found.values) else f"**{text}**"


def _line(row: Row, found: Kept | None) -> str:
    limit = f"{row.limit.text} {row.unit}".strip()
    if found is None:
        return f"| `{row.name}` | {row.claim} | {row.means} | not run on this commit | {limit} | |"
    detail = f"; {found.detail}" if found.detail else ""
    return (
        f"| `{row.name}` | {row.claim} | {row.means} | {shown(row, found)}{detail} | {limit} | {found.date} |"
    )


def _machines(rows: Sequence[Row], kept: Mapping[str, Kept]) -> str:
    """The machines on which the rows were measured."""
    machines = sorted({kept[row.name].machine for row in rows if row.name in kept})
    return f"Measured on {'; '.join(machines)}."


def write_page(text: str, path: Path = FILE) -> None:
    path.write_text(text, encoding="utf-8")
