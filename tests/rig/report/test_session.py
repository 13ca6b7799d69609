"""`rig report`: page, figures and tables of a measured session."""

import json
import re
import shutil
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.errors import RecordError
from rig.analysis import RunResults, SessionResults, model_curves, read_results, write_results
from rig.report.session_report import make_report

FIGURES = (
    "fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory", "fig12-decay", "fig13-period",
    "residuals", "table4-loops", "losses",
)  # fmt: skip
PNG = b"\x89PNG\r\n\x1a\n"


class Sources(HTMLParser):
    """Everything of a page that a browser would fetch, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.fetched += [
            value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "poster")
        ]

    def handle_data(self, data: str) -> None:
        self.text += data


def parsed(page: Path) -> Sources:
    sources = Sources()
    sources.feed(page.read_text(encoding="utf-8"))
    return sources


def results_of(folder: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return tree


def test_the_page_needs_nothing_beside_it(measured_series: Path) -> None:
    page = parsed(measured_series / "report.html")
    figures = [source for source in page.fetched if source.startswith("data:image/")]
    assert len(figures) == 2 * len(FIGURES) + 1  # both runs, and the series
    assert figures == page.fetched
    assert not page.tags & {"script", "link", "iframe", "object"}
    style = (measured_series / "report.html").read_text(encoding="utf-8").split("</style>")[0]
    assert not re.search(r"url\(|@import|@font-face", style)
    # every figure is a file, too
    made = {path.stem: path.read_bytes() for path in (measured_series / "report" / "run-2").iterdir()}
    assert set(made) == set(FIGURES)
    assert all(
        data.startswith(PNG) if name == "fig00-frame" else b"<svg" in data[:2000]
        for name, data in made.items()
    )
    assert (measured_series / "report" / "series.svg").stat().st_size > 1000


def test_tables_hold_the_numbers_of_the_results(measured_series: Path) -> None:
    tree, page = read_results(measured_series), measured_series / "report.html"
    for number, run in enumerate(tree.runs, start=1):
        texts = [[escape(text, quote=True) for text in (row.shown.symbol, row.text)] for row in run.contact]
        assert [row[:2] for row in html_table(page, "Parameters of the contact, exact fit", number)] == texts
        # the first budget of the page is that of the series
        shares = [row[-1] for row in html_table(page, "Uncertainty budget (GUM)", number + 1)]
        for entry in run.budget.values():
            for source in entry.sources:
                assert source.share < 0.005 or f"{100 * source.share:.1f} %" in shares
    assert tree.series is not None
    for line in html_table(page, "The series", 1):
        (row,) = [row for row in tree.series.table if escape(row.shown.label, quote=True) == line[0]]
        assert line[1] == escape(row.text, quote=True)


def test_curves_are_those_of_the_fits(measured_series: Path) -> None:
    """Drawn again from results.json alone, the exact curve has the fit's own relative error."""
    run = read_results(measured_series).runs[0]
    for name, curve in model_curves(run).items():
        # against the model instead of the data: equal to first order in errors of 1e-5
        errors = np.abs(curve.amplitude_residual_rad / curve.model_amplitude_rad)
        assert np.mean(errors) == pytest.approx(run.fits[name].arae_decay, rel=1e-3)


def test_the_page_says_what_was_measured_when_by_whom_and_with_what(measured_series: Path) -> None:
    """Values with whole uncertainty or bound, what to cite; figures in their order."""
    text, tree = parsed(measured_series / "report.html").text, results_of(measured_series)
    first, session = tree["runs"][0], read_results(measured_series)
    words = ("operatordemonstration", "steel ball on K8 glass", first["sha256"], "numpy", "lever.u_arm_m")
    cited = "doi:10.3390/lubricants11020088"
    for word in (*words, session["c"].text, session["gamma"].text, cited):
        assert word in text
    named = text.index("surface energy σ")
    assert named < text.index("σ (Table 2's form)", named + 20)
    order = [text.index(f"{name}: ") for name in ("Fig. 9", "Fig. 10", "Fig. 11", "Figs. 13 and 14")]
    assert order == sorted(order)
    assert first["half_cycles"] == 33
    assert "33 half-cycles" in text
    assert re.search(r"Run 1began 20\d\d-\d\d-\d\d \d\d:\d\d:\d\d UTC", text)
    assert text.count("ambient conditions") == 1, "what surrounds both runs alike is said once"
    assert [run["simulated"] for run in tree["runs"]] == [True, True]
    assert "<title>SIMULATED: " in (measured_series / "report.html").read_text(encoding="utf-8")
    assert "SIMULATED: every number comes from the simulated rig" in text


def test_the_budget_is_sorted_adds_up_and_has_what_is_stated(measured_series: Path) -> None:
    """a ~ (m R)^(1/3): relative uncertainties of 4.9e-4 and 3.3e-4 give a third of their root sum."""
    run = results_of(measured_series)["runs"][0]
    for entry in run["budget"].values():
        parts = [source["share"] for source in entry["sources"]]
        assert parts == sorted(parts, reverse=True)
        assert sum(parts) == pytest.approx(1.0)
    (radius,) = [row for row in run["table"] if row["quantity"] == "contact_radius_m"]
    expected = ((0.0002 / 0.406) ** 2 + (2e-6 / 6.05e-3) ** 2) ** 0.5 / 3
    assert radius["u_total"] / radius["value"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("figures")
def test_a_report_can_be_made_again_elsewhere(measured_series: Path, tmp_path: Path) -> None:
    page = make_report(measured_series, tmp_path / "again.html")
    assert page == tmp_path / "again.html"
    assert page.read_bytes() == (measured_series / "report.html").read_bytes()
    assert (tmp_path / "again" / "run-1" / "fig12-decay.svg").exists()


def test_a_changed_record_is_said(measured_series: Path, tmp_path: Path) -> None:
    for number in (1, 2):
        shutil.copy(measured_series / "run-1.mcap", tmp_path / f"run-{number}.mcap")
    shutil.copy(measured_series / "results.json", tmp_path)
    assert "its hash differs" in parsed(make_report(tmp_path)).text


def test_what_is_quoted_names_the_runs_that_it_is_of(measured_series: Path, tmp_path: Path) -> None:
    """Two fitted runs of three were said to be "3 runs"; a fitted run after one that is not stood nowhere."""
    found = read_results(measured_series)
    one, two = (replace(run, record=str((measured_series / run.record).resolve())) for run in found.runs)
    unfitted = replace(one, fits={}, table=(), budget={}, half_cycles=7, problem="too short")
    assert found.series is not None
    series = replace(found.series, combined_runs=(2, 3))
    for runs, of_runs, together in (
        ((unfitted, one, two), "From 2 runs with 66 half-cycles", series),
        ((unfitted, two), "From one run with 33 half-cycles", None),
    ):
        results = replace(found, runs=runs, series=together)
        folder = tmp_path / str(len(runs))
        folder.mkdir()
        write_results(folder / "results.json", results)
        text = parsed(make_report(folder)).text
        assert of_runs in text
        assert "Nothing was fitted" not in text
        assert results["gamma"].text in text.partition("Summary")[0]


def test_without_results_or_their_record_there_is_no_report(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"holds no results\.json; rig run makes one"):
        make_report(tmp_path)
    write_results(tmp_path / "results.json", SessionResults(runs=(RunResults(record="run-1.mcap"),)))
    with pytest.raises(RecordError, match=r"run-1\.mcap: no such record"):
        make_report(tmp_path)


def test_nothing_is_stated_of_amplitudes_that_were_not_measured(measured_series: Path) -> None:
    """The runs end at 101 arcsec: Table 4's loop at 3.1 arcsec would be the law's own, not the pendulum's."""
    for number, run in enumerate(results_of(measured_series)["runs"], start=1):
        rows = {item["quantity"]: item["value"] for item in run["table"]}
        lowest, highest = rows["final_amplitude"], rows["initial_amplitude"]
        assert lowest > 90
        amplitudes = [work["amplitude_arcsec"] for work in run["work_per_cycle"]]
        assert len(amplitudes) == 2
        assert all(0.999 * lowest <= amplitude <= 1.001 * highest for amplitude in amplitudes)
        (c,) = [item for item in run["table"] if item["quantity"] == "c"]
        assert c["verdict"] != "determined"
        for work in run["work_per_cycle"]:
            assert work["dissipated_4a_j"]["standard_uncertainty"] > 0
            assert work["adhesive_4at_j"] == {"value": None, "standard_uncertainty": None}
        shown = html_table(measured_series / "report.html", "Work over one cycle", number)
        assert all("95 %" in adhesive and share == "–" for _, _, adhesive, share in shown)
    assert "3.1 arcsec" not in parsed(measured_series / "report.html").text


def html_table(page: Path, title: str, number: int) -> list[list[str]]:
    """The cells of one of the page's tables with this title, counted from 1."""
    part = page.read_text(encoding="utf-8").split(f"{title}</h3>")[number].split("</table>")[0]
    body = part.split("<tbody>")[1]
    return [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in body.split("</tr>") if "<td" in row]
