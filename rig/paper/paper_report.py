"""Output of `rig paper`: tables on the terminal, and an HTML page with tables and figures."""

from collections.abc import Sequence
from pathlib import Path

from acquisition import atomic_write
from processing.errors import RecordError
from processing.fit import FitMethod
from rig.analysis import curves_of
from rig.paper.comparison import table1, table2, table3, table4
from rig.paper.printed import CONTRADICTIONS, LOOP_AMPLITUDE_ARCSEC, PAIRS, SOURCE
from rig.paper.shaken import shaken_pair, table5
from rig.paper.simulation import NOISE_ARCSEC, PairSeries, simulate_pair
from rig.presentation import Table, answer, print_line, print_tables
from rig.report import (
    ReportFigure,
    figures_contact,
    figures_laws,
    figures_motion,
    html,
    save_figures,
    save_tables,
    series_table,
    styled,
)

_SEED = 1


def reproduce_paper(output: Path | None, b_exponent: int) -> None:
    """Simulate and analyse the three contact pairs, three runs each, and print Tables 1 to 4 with the paper's
    values; and one more of the same pairs on a ground that makes the printed residuals.

    With `output`, a page ``paper.html`` with Figs. 9 to 14 is written into that folder, and the figures (SVG,
    PNG) and tables (CSV) into its subfolder ``paper``.
    """
    found = [
        simulate_pair(pair, b_exponent, _SEED + 1000 * place) for place, pair in enumerate(PAIRS, start=1)
    ]
    shaken = [
        shaken_pair(pair, b_exponent, _SEED + 1000 * place) for place, pair in enumerate(PAIRS, start=1)
    ]
    tables = [table1(), table2(found, b_exponent), table3(found), table4(found), table5(shaken)]
    print_tables(tables)
    print_line("Known contradictions of the printed text:")
    for line in CONTRADICTIONS:
        print_line(f"- {line}")
    if output is not None:
        page = write_paper(output, found, tables)
        answer(written=[page])
        print(page)


def write_paper(output: Path, found: Sequence[PairSeries], tables: Sequence[Table]) -> Path:
    """Write the page and its files into a folder; returns the page. RecordError if that is not possible."""
    files = output / "paper"
    target = output / "paper.html"
    body = [
        html.paragraph(
            "The three contact pairs are simulated with the paper's parameters, three runs each: the "
            f"equation of motion is integrated, noise of {NOISE_ARCSEC:g} arcsec is added to each of the "
            "100 positions per second, half-cycles are detected, both fits are made, and the runs are "
            "combined. The simulator shares no formula with the analysis."
        ),
        html.heading("Known contradictions of the printed text", 3),
        html.notes(CONTRADICTIONS),
        *(html.table(content) for content in tables),
    ]
    try:
        files.mkdir(parents=True, exist_ok=True)
        save_tables(tables, files)
        for series in found:
            folder = files / series.pair.flat
            folder.mkdir(exist_ok=True)
            combined = series_table(series.series)
            save_tables([combined], folder)
            body.append(html.heading(series.pair.name[0].upper() + series.pair.name[1:]))
            body.append(html.table(combined))
            with styled():
                body += save_figures(_drawings(series), folder)
        page = html.page(f"Tables and figures of {SOURCE}", "made again", body)
        atomic_write.take_away_leftovers(target.parent, target.name)
        atomic_write.write_new(target, page.encode())
    except OSError as error:
        raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
    return target


def _drawings(series: PairSeries) -> list[ReportFigure]:
    points, motion = series.points[0], series.motion
    curves = curves_of(points, series.run)
    exact = series.run.fits[FitMethod.EXACT]
    period_s = exact.mean_period_s.value
    drawings = [
        figures_motion.slow_figure(motion, period_s),
        figures_motion.fast_figure(motion, period_s),
        figures_motion.trajectory_figure(motion, period_s),
    ]
    if curves is not None:
        drawings += [
            figures_laws.decay_figure(points, curves, motion.unit),
            figures_laws.period_figure(curves),
            figures_laws.smooth_figure(curves),
        ]
    drawings.append(
        figures_contact.loop_figure(exact.contact(), series.pendulum, LOOP_AMPLITUDE_ARCSEC, sees_c=True)
    )
    return drawings
