"""The beginning of a report: title, verdict beside the first decay, and how all this was measured."""

from collections.abc import Mapping
from pathlib import Path

from processing.contact.laws import DEFAULT_LAW
from processing.fit import Budget
from processing.instruments import INSTRUMENTS
from rig.analysis import (
    SURFACE_ENERGY,
    RowsByName,
    decay_lines,
    dominant_text,
    has_apparatus,
    named,
    remarks,
    whole_result,
)
from rig.presentation import latex_rows, plain, quantity
from rig.report import html
from rig.report.source import ReportSource, RunData
from rig.report.tables import headline

_NOT_STATED = "not stated"
_PAPER = "I. Gilavdary, S. Mekid, N. Riznookaya, Lubricants 2023, 11(2), 88, doi:10.3390/lubricants11020088"


def title_of(source: ReportSource) -> tuple[str, str]:
    """Title and subtitle of the page."""
    first = source.runs[0]
    session = first.provenance.get("session", {})
    name = source.folder.resolve().name
    if first.results.decay is not None:
        run = first.results.decay.run
        name = Path(first.results.record).name + (f", run {run}" if run else "")
    title = session.get("sample") or name
    counted = "decay" if first.is_table else "run"
    words = [f"{len(source.runs)} {counted}{'s' if len(source.runs) > 1 else ''}"]
    if session.get("operator"):
        words.append(f"operator {session['operator']}")
    words += [word for word in (session.get("contact_history"), session.get("notes")) if word]
    if any(run.results.simulated for run in source.runs):
        title = f"SIMULATED: {title}"
    results = first.results
    what = "Free decay of a pendulum on one ball" if results.fits else "Free decay of a pendulum"
    if results.instrument is not None:
        what = INSTRUMENTS[results.instrument.kind].title
    return title, f"{what}: " + ", ".join(words)


def summary_of(source: ReportSource, decay: str) -> list[str]:
    """The verdict with the parameters beside the first decay; below it how all this was measured."""
    run, series = source.runs[0].results, source.series
    body = []
    if any(data.results.simulated for data in source.runs):
        body.append(
            '<div class="warn">SIMULATED: every number comes from the simulated rig; '
            "nothing was measured.</div>"
        )
    first = [html.verdict(_verdict(source))]
    found = series if series is not None and series.table else run
    if found.contact:
        first.append(html.key_values(_key_results(found, found.budget)))
        what = "combined over the runs" if found is series else "of the run"
        first.append(
            html.paragraph(
                f"Exact fit {what}, value ± standard uncertainty: of swings and apparatus together where the "
                "main sources are named, otherwise of the swings alone.",
                "note",
            )
        )
    if run.instrument is not None:
        values = headline(run, None if series is None else series.instrument)
        first.append(html.key_values(values))
        first.append(html.paragraph("Value ± standard uncertainty of the swings.", "note"))
    body.append(html.first_screen(first, [decay]))
    body.append(html.heading("Summary"))
    body.append(html.facts(_circumstances(source)))
    for data in source.runs:
        body.append(html.paragraph(sentence(data)))
        if data.results.problem:
            body.append(f'<div class="warn">{html.escape("No fit: " + data.results.problem)}</div>')
            body.append(html.notes(decay_lines(data.results)))
    if len(source.runs) == 1:
        body.append(html.notes(notes_of(source.runs[0])))
    return body + (_to_copy(source, found) if found.contact else [])


def _verdict(source: ReportSource) -> list[tuple[str, str]]:
    """The result, what limits it and what to do, and whether the conditions of the runs held."""
    first = source.runs[0].results
    found = whole_result(first, source.series)
    lines = [(found.text or "Nothing was fitted", "")]
    if found.limits:
        limited = ", ".join(f"{one.name} {100 * one.share:.0f} %" for one in found.limits[:2])
        lines.append((f"Its uncertainty: {limited}. Next: {'; '.join(found.next_steps)}.", ""))
    judged = [item for run in source.runs for item in run.results.conditions]
    broken = [item for item in judged if not item.ok]
    doubtful = [item for item in judged if item.ok and item.remedy]
    if broken:
        names = ", ".join(dict.fromkeys(item.name for item in broken))
        lines.append((f"Conditions NOT met: {names}", "bad"))
    elif judged:
        names = ", ".join(dict.fromkeys(item.name for item in doubtful))
        lines.append(
            (f"Conditions met, with a warning of {names}" if names else "All conditions met", "good")
        )
    return lines


def _circumstances(source: ReportSource) -> list[tuple[str, str]]:
    """Who measured, when each run began and how long it lasted, what surrounded it, and with what."""
    first = source.runs[0]
    rows = []
    if first.results.instrument is not None:
        kind = INSTRUMENTS[first.results.instrument.kind]
        rows.append(("instrument", f"{kind.sentence.rstrip('.')} ({kind.kind})"))
    rows.append(("operator", first.provenance.get("session", {}).get("operator", "") or _NOT_STATED))
    around = [_surroundings(run) for run in source.runs]
    alike = len(set(around)) == 1
    for run, surroundings in zip(source.runs, around, strict=True):
        began = run.provenance["file"].get("began", "")
        text = f"{began and f'began {began}, '}lasted {_lasted(run)}"
        rows.append((run.title, text if alike else f"{text}; {surroundings or f'air {_NOT_STATED}'}"))
    if alike:
        rows.append(("ambient conditions", around[0] or _NOT_STATED))
    if first.is_table:
        rows.append(("positions from", first.results.record))
    else:
        driver = first.provenance.get("camera", {}).get("driver", "")
        stored = "a film or a folder of images" if driver == "files" else "a camera"
        rows.append(("frames from", "the simulated rig" if first.results.simulated else stored))
    rows += [("laws of the contact", _PAPER)] if first.results.fits else []
    return [(name, text) for name, text in rows if text]


def _lasted(run: RunData) -> str:
    time_s = run.motion.time_s if len(run.motion.time_s) else run.results.points.time_s
    length_s = time_s[-1] - time_s[0] if len(time_s) else 0.0
    return f"{length_s / 60:.1f} min"


def _surroundings(run: RunData) -> str:
    """Air and history of the contact."""
    found = run.results.surroundings
    said = []
    for name, value in ({} if found is None else found.known()).items():
        shown = quantity(name)
        said.append(f"{shown.name} {plain(value * shown.factor, 4)} {shown.unit}")
    return ", ".join(said)


def _key_results(found: RowsByName, budget: Mapping[str, Budget]) -> list[tuple[str, str]]:
    """Labels and values; with what dominates the whole uncertainty where the apparatus has a part."""
    names = [SURFACE_ENERGY, *DEFAULT_LAW.names(drag=True)]
    shown = []
    for row in (found.rows[name] for name in names if name in found.rows):
        item, label = budget.get(row.quantity), named(row.quantity)
        if row.determined and item is not None and has_apparatus(item):
            label = f"{label} (u: {dominant_text(item)})"
        shown.append((label, row.text))
    return shown


def _to_copy(source: ReportSource, found: RowsByName) -> list[str]:
    """A sentence with the values and what to cite, and a row for a table in LaTeX."""
    rows = [found.rows[name] for name in (*DEFAULT_LAW.names(), SURFACE_ENERGY) if name in found.rows]
    first = source.runs[0]
    several = f"{len(source.runs)} runs" if len(source.runs) > 1 else "one run"
    half_cycles = sum(data.results.half_cycles for data in source.runs)
    version = first.provenance.get("versions", {}).get("optical-pendulum-rig", "")
    simulated = "SIMULATED: " if any(data.results.simulated for data in source.runs) else ""
    values = ", ".join(row.equation for row in rows)
    text = (
        f"{simulated}From {several} with {half_cycles} half-cycles: {values} (standard uncertainties of "
        "swings and apparatus together, as far as they are stated, or 95 % limits; exact fit by "
        f"optical-pendulum-rig{f' {version}' if version else ''} of the laws of {_PAPER})."
    )
    head = [quantity(row.quantity).label for row in rows]
    return [
        html.heading("To copy", 3),
        html.paragraph(text),
        html.preformatted(latex_rows(head, [row.text for row in rows], title_of(source)[0])),
    ]


def sentence(run: RunData) -> str:
    """How much was measured in a run, in one sentence."""
    results, unit = run.results, run.motion.unit.shown
    left_out = len(run.results.stored.left_out_flags)
    taken = (
        f"{results.frames} rows"
        if run.is_table
        else f"{results.frames} frames, {results.dropped_frames} dropped"
    )
    return (
        f"{run.title}: {results.half_cycles_text(unit, ' from ')} in {_lasted(run)}; {taken}; "
        f"{left_out} half-cycle{'s' if left_out != 1 else ''} flagged and left out."
    )


def notes_of(run: RunData) -> list[str]:
    """What is to be said of a run, with its warnings."""
    return [*remarks(run.results), *run.results.warnings, *run.notes]
