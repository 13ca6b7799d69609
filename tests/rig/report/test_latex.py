"""Tables for LaTeX: siunitx's numbers and units, the catalogue's symbols."""

import re
from pathlib import Path

import pytest

from processing.units import _OTHERS, _PREFIXABLE
from rig.terminal import Table, TableRow, latex_table
from rig.terminal.latex import _UNITS, _UNNAMED_UNITS
from tests.rig.command_line import rig


def lines_of(*row: str, head: tuple[str, ...] = ("", "value", "unit")) -> list[str]:
    table = Table("t", "Title", head, head, [TableRow(row, row)])
    return latex_table(table).splitlines()


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        ("(3.7333 ± 0.0030) × 10⁻³", r"\num{3.7333 +- 0.0030 e-3}"),
        ("−1234 ± 12", r"\num{-1234 +- 12}"),
        ("0.09200 ± 0.00020", r"\num{0.09200 +- 0.00020}"),
        ("5.23 × 10⁻⁴", r"\num{5.23 e-4}"),
        ("4.071", r"\num{4.071}"),
        ("< 3.3 × 10⁻⁸ (95 %)", r"$<$ 3.3 $\times 10^{-8}$ (95 \%)"),
        ("γ and T₀ of A_b & c", r"$\gamma$ and $T_{0}$ of A\_b \& c"),
        ("σ (Table 2's form)", r"$\sigma$ (Table 2's form)"),
        ("4Aₜ", r"4$A_{t}$"),
        ("p̄", r"$\bar{p}$"),
    ],
)
def test_a_cell(cell: str, text: str) -> None:
    assert lines_of("x", cell, "")[8] == rf"x & {text} &  \\"


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("MPa", r"\unit{\mega\pascal}"),
        ("mJ/m²", r"\unit{\milli\joule\metre\tothe{-2}}"),
        ("rad⁻ᵖ", r"\unit{rad^{-p}}"),
        ("%", r"\unit{\percent}"),
        ("", ""),
    ],
)
def test_a_unit(unit: str, text: str) -> None:
    assert lines_of("x", "1", unit)[8] == rf"x & \num{{1}} & {text} \\"


def test_every_unit_of_the_table_has_a_name_or_is_a_count() -> None:
    """But mas, in which nothing is reported."""
    assert {*_OTHERS, *_PREFIXABLE} - {"mas"} == {*_UNITS, *_UNNAMED_UNITS}


def test_a_heading_names_its_unit() -> None:
    found = lines_of("1", "2", head=("α / arcsec", "σ / (mJ/m²)"))[6]
    assert found == r"$\alpha$ / \unit{\arcsecond} & $\sigma$ / \unit{\milli\joule\metre\tothe{-2}} \\"


def test_the_tables_of_a_report_are_exported(measured_series: Path, tmp_path: Path) -> None:
    done = rig("export", measured_series, "--format", "latex", "-o", tmp_path / "tex")
    assert done.returncode == 0, done.stderr
    made = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "tex").iterdir()}
    assert {"run-1-parameters.tex", "run-2-budget.tex", "series-budget.tex"} <= set(made)
    for name, text in made.items():
        assert text.isascii(), (name, re.findall(r"[^\x00-\x7f]+", text))
        assert len(re.findall(r"\\begin", text)) == len(re.findall(r"\\end\{", text)) == 2
        body = text.split(r"\toprule")[1].split(r"\bottomrule")[0]
        counts = {len(re.findall(r"(?<!\\)&", line)) for line in body.splitlines() if line.endswith(r"\\")}
        assert len(counts) == 1, name
        assert text.count("{") == text.count("}")
    assert r"$\gamma$" in made["run-1-parameters.tex"]
    assert r"\unit{\mega\pascal}" in made["run-1-parameters.tex"]
    again = rig("export", measured_series, "--format", "latex", "-o", tmp_path / "tex")
    assert "exists already" in again.stderr
