"""A run's fits are shown in the same way on the terminal and in the report."""

import logging
import re
from pathlib import Path

import pytest

from processing.contact import SurfaceEnergy
from processing.estimate import Determinacy, Estimate
from processing.fit import Determination
from rig.analysis import (
    Fit,
    RunResults,
    SessionResults,
    SurfaceEnergies,
    parameter_table,
    print_results,
    quality_table,
    read_results,
)

_RUN = RunResults(
    record="run-1.mcap",
    half_cycles=33,
    initial_amplitude=123.2,
    final_amplitude=101.1,
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
    surface_energy_j_per_m2=SurfaceEnergies(
        Estimate(0.003, 0.09),
        Estimate(0.001, 0.03),
        {"asymptotic": SurfaceEnergy(Estimate(-0.006, 0.09), Estimate(-0.002, 0.03))},
    ),
    identifiability=(
        Determination(
            name="c",
            verdict=Determinacy.UPPER_BOUND,
            value=1e-9,
            lower_95=0.0,
            upper_95=6.1e-8,
            text="c below 6.1e-8",
        ),
    ),
)


def test_the_terminal_shows_the_report_s_tables(capsys: pytest.CaptureFixture[str]) -> None:
    print_results(SessionResults(runs=(_RUN,)), [])
    printed = capsys.readouterr().out
    tables = [
        parameter_table(_RUN.fits, _RUN.surface_energy_j_per_m2, _RUN.verdicts()),
        quality_table(_RUN.fits),
    ]
    for table in tables:
        for row in table.shown:
            assert all(cell in printed for cell in row), row


def test_what_is_not_determined_is_a_bound_in_the_default_fit_alone() -> None:
    table = parameter_table(_RUN.fits, _RUN.surface_energy_j_per_m2, _RUN.verdicts())
    rows = {row[0]: row[1:] for row in table.shown}
    assert table.head == ("", "Eqs. 5 and 6", "exact map", "unit")
    assert rows["c"][1] == "< 6.1 × 10⁻⁸ (95 %)"
    assert rows["σ (Table 2's form)"][1].startswith("< ")
    assert "±" in rows["c"][0]
    assert "±" in rows["b"][1]


def test_relative_errors_are_in_per_cent_and_a_count_is_a_whole_number() -> None:
    rows = {row[0]: row[1:] for row in quality_table(_RUN.fits).shown}
    assert rows["ARAE of the amplitudes, Eq. 8"] == ["–", "1.20", "%"]
    assert rows["degrees of freedom"] == ["0", "58", ""]


def test_a_fit_that_only_one_method_made_has_empty_cells_for_the_other() -> None:
    fits = {"exact": _RUN.fits["exact"], "another": Fit(parameters={"p": Estimate(0.9, 0.01)})}
    table = parameter_table(fits, None, {})
    rows = {row[0]: row[1:] for row in table.shown}
    assert table.head == ("", "exact map", "another", "unit")
    assert rows["p"][0] == ""
    assert rows["c"][1] == ""


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
