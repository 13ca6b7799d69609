"""A run's fits are shown in the same way on the terminal and in the report."""

import logging
import re
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from processing.estimate import Determinacy, Estimate
from processing.fit import Budget
from processing.fit.uncertainty import BudgetSource
from rig.analysis import (
    Fit,
    RunResults,
    SessionResults,
    parameter_table,
    print_results,
    quality_table,
    read_results,
)
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow
from rig.terminal import Verdict

_RUN = RunResults(
    record="run-1.mcap",
    half_cycles=33,
    amplitude_unit="arcsec",
    fits={
        "exact": Fit(
            parameters={"b": Estimate(3.5e-3, 1e-5), "c": Estimate(1e-9, 3e-8)},
            chi2_per_dof=1.16,
            degrees_of_freedom=58,
            arae_decay=0.012,
        ),
        "asymptotic": Fit(parameters={"b": Estimate(3.7e-3, 1e-5), "c": Estimate(-2e-9, 3e-8)}),
    },
    table=(
        ResultRow(quantity="initial_amplitude", fit="decay", value=123.2),
        ResultRow(quantity="final_amplitude", fit="decay", value=101.1),
        ResultRow(quantity="b", value=3.5e-3, u=1e-5, u_total=1e-5, lower=3.48e-3, upper=3.52e-3),
        ResultRow(quantity="c", verdict=Determinacy.UPPER_BOUND, lower=0.0, upper=6.1e-8),
        ResultRow(quantity=SURFACE_ENERGY, verdict=Determinacy.UPPER_BOUND, lower=0.0, upper=0.183),
        ResultRow(quantity="b", fit="asymptotic", value=3.7e-3, u=1e-5, u_total=1e-5),
    ),
)


def test_the_terminal_shows_the_report_s_tables_where_asked(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="rig.analysis.screen")
    print_results(SessionResults(runs=(_RUN,)), [])
    printed = capsys.readouterr().out
    tables = [
        parameter_table(_RUN),
        quality_table(_RUN.fits),
    ]
    for table in tables:
        for row in table.shown:
            assert all(cell in printed for cell in row), row


def with_apparatus() -> RunResults:
    """The run where E of the flat makes most of the doubt of b."""
    sources = (
        BudgetSource("flat_youngs_modulus_pa", "B", 1e9, 1e-13, 1e-4, 0.99),
        BudgetSource("swings", "A", nan, nan, 1e-5, 0.01),
    )
    whole = Budget(
        value=3.5e-3,
        standard_uncertainty=1e-4,
        sources=sources,
    )
    rows = (*_RUN.table[:2], replace(_RUN.table[2], u_total=1e-4), *_RUN.table[3:])
    return replace(_RUN, budget={"b": whole}, table=rows)


@pytest.mark.parametrize("verbose", [False, True])
def test_the_terminal_shows_the_whole_uncertainty_and_that_of_the_swings_alone_where_asked(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, verbose: bool
) -> None:
    caplog.set_level(logging.INFO if verbose else logging.WARNING, logger="rig.analysis.screen")
    met = Verdict("lost spots", ok=True, measured="0 %", limit="1 %")
    wished = Verdict("beam", ok=True, reason="it is wide", remedy="focus it", measured="9 px", limit="12 px")
    failed = Verdict("end", ok=False, reason="it was cut", remedy="measure again", measured="", limit="whole")
    run = replace(with_apparatus(), conditions=(met, wished, failed))
    print_results(SessionResults(runs=(run,)), [])
    printed = capsys.readouterr().out
    assert "LOST SPOTS" not in printed
    assert "BEAM: 9 px (limit 12 px); it is wide; focus it" in printed
    assert "END: " in printed
    (line,) = [line for line in printed.splitlines() if line.startswith("b ")]
    assert "(3.50 ± 0.10) × 10⁻³" in line
    assert "E of the flat 99 %" in line
    # the swings' own uncertainty, a tenth of it, stands behind it and only where asked
    assert (" 1.0 × 10⁻⁵ " in line) == verbose
    assert printed.count("(3.50 ± 0.10)") == 1
    bound = next(line for line in printed.splitlines() if line.startswith("c "))
    assert "< 6.1 × 10⁻⁸ (95 %)" in bound


def test_what_is_not_determined_has_no_value_by_any_method() -> None:
    table = parameter_table(_RUN)
    rows = {row[0]: row[1:] for row in table.shown}
    assert table.head == ("", "value", "unit", "u of the swings", "Eqs. 5 and 6")
    assert rows["c"] == ["< 6.1 × 10⁻⁸ (95 %)", "", "", ""]
    assert rows["σ (Table 2's form)"][0] == "< 183 (95 %)"
    assert "±" in rows["b"][0]
    assert "±" in rows["b"][3]


def test_relative_errors_are_in_per_cent_and_a_count_is_a_whole_number() -> None:
    rows = {row[0]: row[1:] for row in quality_table(_RUN.fits).shown}
    assert rows["ARAE of the amplitudes, Eq. 8"] == ["–", "1.20", "%"]
    assert rows["degrees of freedom"] == ["0", "58", ""]


def test_a_fit_that_only_one_method_made_has_empty_cells_for_the_other() -> None:
    fits = {"exact": _RUN.fits["exact"], "another": Fit(parameters={"p": Estimate(0.9, 0.01)})}
    table = parameter_table(replace(_RUN, fits=fits))
    assert table.head[-1] == "another"
    assert {row[0]: row[-1] for row in table.shown}["b"] == ""


def test_a_run_without_half_cycles_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    run = RunResults(record="run-1.mcap", frames=99, amplitude_unit="arcsec", problem="too few half-cycles")
    print_results(SessionResults(runs=(run,)), [])
    printed = capsys.readouterr().out
    assert "run 1: no half-cycles, 99 frames, 0 dropped" in printed
    assert "nan" not in printed


def test_several_runs_share_one_table_and_more_is_shown_on_request(
    measured_series: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    results = read_results(measured_series)
    print_results(results, [])
    short = capsys.readouterr().out
    assert re.search(r"run 1 +run 2 +together +unit", short)
    assert "Quality of the fits" not in short
    with caplog.at_level(logging.INFO, "rig"):
        print_results(results, [])
    long = capsys.readouterr().out
    assert long.count("Quality of the fits") == 2
    assert re.search(r"run 1 +run 2 +together +unit", long)
