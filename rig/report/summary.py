"""The beginning of a report: title, verdict beside the first decay, circumstances of the measurement."""

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
from rig.report import html
from rig.report.source import ReportSource, RunData
from rig.report.tables import headline
from rig.terminal import latex_rows, plain, quantity

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
    """The verdict with the parameters beside the first decay; below it the circumstances."""
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
        body.append(html.paragraph(run_sentence(data)))
        if data.results.problem:
            body.append(f'<div class="warn">{html.escape("No fit: " + data.results.problem)}</div>')
            body.append(html.notes(decay_lines(data.results)))
    if len(source.runs) == 1:
        body.append(html.notes(notes_of(source.runs[0])))
    return body + (_text_to_copy(source, found) if found.contact else [])


def _verdict(source: ReportSource) -> list[tuple[str, str]]:
    """The result, its largest uncertainties, the next step, and whether conditions were met, as lines."""
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
    """Operator, begin and duration of each run, ambient conditions, and source of the positions."""
    first = source.runs[0]
    rows = []
    if first.results.instrument is not None:
        kind = INSTRUMENTS[first.results.instrument.kind]
        rows.append(("instrument", f"{kind.sentence.rstrip('.')} ({kind.kind})"))
    rows.append(("operator", first.provenance.get("session", {}).get("operator", "") or _NOT_STATED))
    ambient = [_ambient_conditions(run) for run in source.runs]
    is_common = len(set(ambient)) == 1
    for run, conditions in zip(source.runs, ambient, strict=True):
        began = run.provenance["file"].get("began", "")
        text = f"{began and f'began {began}, '}lasted {_duration_text(run)}"
        rows.append((run.title, text if is_common else f"{text}; {conditions or f'air {_NOT_STATED}'}"))
    if is_common:
        rows.append(("ambient conditions", ambient[0] or _NOT_STATED))
    if first.is_table:
        rows.append(("positions from", first.results.record))
    else:
        driver = first.provenance.get("camera", {}).get("driver", "")
        stored = "a film or a folder of images" if driver == "files" else "a camera"
        rows.append(("frames from", "the simulated rig" if first.results.simulated else stored))
    rows += [("laws of the contact", _PAPER)] if first.results.fits else []
    return [(name, text) for name, text in rows if text]


def _duration_text(run: RunData) -> str:
    time_s = run.motion.time_s if len(run.motion.time_s) else run.results.points.time_s
    length_s = time_s[-1] - time_s[0] if len(time_s) else 0.0
    return f"{length_s / 60:.1f} min"


def _ambient_conditions(run: RunData) -> str:
    """The ambient conditions of a run, in words."""
    found = run.results.surroundings
    texts = []
    for name, value in ({} if found is None else found.known()).items():
        shown = quantity(name)
        texts.append(f"{shown.name} {plain(value * shown.factor, 4)} {shown.unit}")
    return ", ".join(texts)


def _key_results(found: RowsByName, budget: Mapping[str, Budget]) -> list[tuple[str, str]]:
    """Labels and values; the label names the dominant source if the apparatus contributes to u."""
    names = [SURFACE_ENERGY, *DEFAULT_LAW.names(drag=True)]
    shown = []
    for row in (found.rows[name] for name in names if name in found.rows):
        item, label = budget.get(row.quantity), named(row.quantity)
        if row.determined and item is not None and has_apparatus(item):
            label = f"{label} (u: {dominant_text(item)})"
        shown.append((label, row.text))
    return shown


def _text_to_copy(source: ReportSource, found: RowsByName) -> list[str]:
    """A sentence with the values and the reference to cite, and a row for a table in LaTeX."""
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


def run_sentence(run: RunData) -> str:
    """A sentence on the extent of a run: half-cycles, duration, frames, flags."""
    results, unit = run.results, run.motion.unit.shown
    left_out = len(run.results.stored.left_out_flags)
    taken = (
        f"{results.frames} rows"
        if run.is_table
        else f"{results.frames} frames, {results.dropped_frames} dropped"
    )
    return (
        f"{run.title}: {results.half_cycles_text(unit, ' from ')} in {_duration_text(run)}; {taken}; "
        f"{left_out} half-cycle{'s' if left_out != 1 else ''} flagged and left out."
    )


def notes_of(run: RunData) -> list[str]:
    """Remarks, warnings and notes of a run."""
    return [*remarks(run.results), *run.results.warnings, *run.notes]
