"""The table of results: one interval and one verdict of each quantity, whichever output shows it, and how."""

import json
import logging
import re
from dataclasses import replace
from math import isnan, log, nan
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError
from processing.estimate import Determinacy, Estimate
from processing.fit import (
    Budget,
    Determination,
    FitResult,
    budgets,
    fit_exact,
    identifiability,
)
from processing.fit.uncertainty import BudgetSource
from processing.series import CombinedValue, combine
from rig.analysis import (
    Fit,
    RunResults,
    Series,
    SessionResults,
    analyse_record,
    encoded,
    parameter_table,
    print_results,
    quality_table,
    read_results,
)
from rig.analysis.result_rows import (
    SURFACE_ENERGY,
    ResultRow,
    plain_row,
    result_rows,
    rows_of_others,
    series_rows,
    withheld,
)
from rig.report.tables import budget_table
from rig.terminal import Verdict, latex_table
from tests.processing.fit.decays import decay, paper_pair
from tests.processing.fit.test_uncertainty import rig

SERIES = Path(__file__).resolve().parents[1] / "data" / "samples" / "series"

_PENDULUM = rig().pendulum()


@pytest.fixture(scope="module")
def long_fit() -> FitResult:
    parameters, pendulum = paper_pair("glass_k8")
    return fit_exact(decay(parameters, pendulum, noise_arcsec=0.005, seed=3, last_arcsec=20), pendulum)


def rows_of(fit: FitResult, determinations: tuple[Determination, ...] = ()) -> dict[str, ResultRow]:
    table = budgets(fit, rig())
    return {row.quantity: row for row in result_rows("run-1", fit, determinations, table, _PENDULUM)}


@pytest.mark.slow
def test_a_short_run_has_the_profile_s_interval_in_every_output() -> None:
    """b of 75 s: the budget said 2.7e-5 to 2.4e-3, the profile 7.2e-5 to 0.02; the truth is 3.7e-3."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.5, seed=3, last_arcsec=105)
    fit = fit_exact(points, pendulum)
    determinations = identifiability(points, pendulum, fit)
    budget = budgets(fit, rig())
    table = result_rows("run-1", fit, determinations, budget, pendulum)
    run = RunResults(record="run-1.mcap", table=table, budget=withheld(budget, table))
    open_ones = [one for one in determinations if one.verdict is not Determinacy.DETERMINED]
    assert {"b", "c"} <= {one.name for one in open_ones}
    for one in open_ones:
        row = run[one.name]
        assert isnan(row.value + row.u + row.u_total)
        for end, of_profile in ((row.lower, one.lower_95), (row.upper, one.upper_95)):
            # the apparatus widens it a little
            assert end == pytest.approx(of_profile, rel=0.02, nan_ok=True)
        assert isnan(run.budget[one.name].standard_uncertainty)
        assert all(isnan(source.contribution) for source in run.budget[one.name].sources)
        assert "±" not in str(row)
    tree = json.dumps(encoded(run))
    assert "expanded" not in tree
    shown = {content.name: content for content in (
        parameter_table(run), budget_table(run.budget, run.rows),
    )}  # fmt: skip
    c = run["c"]
    for content in (shown["parameters"], shown["budget"]):
        assert any(c.text in cells for cells in content.shown)
        assert "pm" not in next(line for line in latex_table(content).splitlines() if line.startswith("c "))


def test_the_whole_uncertainty_comes_first(long_fit: FitResult) -> None:
    """gamma was 29.072 +- 0.093 in LaTeX and 29.07 +- 0.19 on the terminal."""
    rows = rows_of(long_fit)
    budget = budgets(long_fit, rig())
    gamma = rows["gamma_pa"]
    assert gamma.u == long_fit.estimate("gamma_pa").standard_uncertainty
    assert gamma.u_total == pytest.approx(budget["gamma_pa"].standard_uncertainty)
    assert gamma.u_total > 1.5 * gamma.u
    assert tuple(gamma) == (gamma.value, gamma.u_total)
    half = 1.97 * gamma.u_total
    assert log(gamma.upper / gamma.value) == pytest.approx(half / gamma.value, rel=0.02)
    assert gamma.upper - gamma.value > gamma.value - gamma.lower
    run = RunResults(record="run-1.mcap", table=tuple(rows.values()), budget=budget)
    text = latex_table(parameter_table(run))
    line = next(line for line in text.splitlines() if "gamma" in line)
    assert gamma.text.split(" ± ")[1] in line.split("&")[1]
    assert "swings and apparatus together" in text


def test_a_bound_stays_one_and_so_does_that_of_what_follows(long_fit: FitResult) -> None:
    known = Determination("c", Determinacy.UPPER_BOUND, 0.0, 1.4e-8, profile_likelihood=True)
    rows = rows_of(long_fit, (known,))
    c, energy = rows["c"], rows["surface_energy_table2_j_per_m2"]
    assert c.equation == "c < 1.4 × 10⁻⁸ (95 %)"
    assert (c.lower, energy.lower) == (0.0, 0.0)
    assert energy.verdict is Determinacy.UPPER_BOUND
    assert energy.upper / c.upper == pytest.approx(
        budgets(long_fit, rig())["surface_energy_table2_j_per_m2"].value / long_fit.estimate("c").value,
        rel=0.02,
    )
    assert rows["contact_radius_m"].determined
    by_others = rows_of_others("run-1", {"exact": long_fit, "asymptotic": long_fit}, [*rows.values()])
    assert {row.quantity for row in by_others} == {*long_fit.names} - {"c"}, "no value by any method"
    assert {row.fit for row in by_others} == {"asymptotic"}


@pytest.mark.parametrize(
    ("verdict", "lower", "upper", "said"),
    [
        (Determinacy.INTERVAL, 2e-9, 3e-8, "c in (0.200 … 3.00) × 10⁻⁸ (95 %)"),
        (Determinacy.LOWER_BOUND, 2.349e-9, nan, "c > 2.34 × 10⁻⁹ (95 %)"),
        (Determinacy.LOWER_BOUND, 0.0, nan, "c not determined"),
        (Determinacy.UPPER_BOUND, 0.0, 2.34e-8, "c < 2.3 × 10⁻⁸ (95 %)"),
        (Determinacy.UNDETERMINED, nan, nan, "c not determined"),
    ],
)
def test_what_is_not_determined_is_said_in_words(
    verdict: Determinacy, lower: float, upper: float, said: str
) -> None:
    """T0 of at least 3.967 s was printed as above 4.0."""
    row = ResultRow(quantity="c", verdict=verdict, lower=lower, upper=upper)
    assert str(row) == said
    assert repr(row) == f"<{said}>"


def test_without_a_profile_a_weak_parameter_is_withheld(long_fit: FitResult) -> None:
    weak = replace(long_fit, covariance=long_fit.covariance * np.outer(*[[1e3, 1, 1, 1, 1, 1, 1, 1]] * 2))
    rows = rows_of(weak)
    assert rows["b"].verdict is Determinacy.UNDETERMINED
    assert str(rows["b"]) == "b not determined rad⁻ᵖ" or str(rows["b"]) == "b not determined"
    assert rows["p"].determined


def test_a_series_that_scatters_too_much_gives_a_bound() -> None:
    item = CombinedValue(value=-1.2e-8, standard_uncertainty=8e-9, degrees_of_freedom=2)
    rows = series_rows({"c": item, "p": replace(item, value=0.9, standard_uncertainty=0.01)}, {}, _PENDULUM)
    c, p = rows[0], rows[1]
    assert c.verdict is Determinacy.UPPER_BOUND
    assert c.upper == pytest.approx(2.24e-8, rel=0.01)
    assert p.text == "0.900 ± 0.010"
    assert p.upper == pytest.approx(0.943, abs=1e-3)


def test_runs_that_only_limit_a_parameter_have_limits_together_and_no_mean() -> None:
    """The smaller a run's exponent happens to be, the more certain a parabola calls it."""
    found = [Estimate(0.174, 0.186), Estimate(0.051, 0.012)]
    mean = combine("n", found)
    limits = [
        ResultRow(quantity="n", verdict=Determinacy.INTERVAL, lower=0.058, upper=0.884),
        ResultRow(quantity="n", verdict=Determinacy.UPPER_BOUND, upper=0.284),
    ]
    (row,) = series_rows({"n": mean}, {}, _PENDULUM, {"n": limits})
    assert (row.verdict, row.by_profile) == (Determinacy.UPPER_BOUND, True)
    assert row.upper > mean.value + mean.expanded_uncertainty_95
    # limits of what is determined contain the apparatus, and may be any number of times wider
    determined = [ResultRow(quantity="n", lower=x - 30 * u, upper=x + 30 * u) for x, u in found]
    assert series_rows({"n": mean}, {}, _PENDULUM, {"n": determined}) == series_rows(
        {"n": mean}, {}, _PENDULUM
    )


@pytest.mark.parametrize(
    ("limits", "verdict"),
    [
        (((nan, 4.0), (0.04, 4.5)), Determinacy.UNDETERMINED),
        (((nan, 0.3), (nan, 0.15)), Determinacy.UPPER_BOUND),
    ],
)
def test_limits_beyond_the_range_of_the_law_are_none(
    limits: tuple[tuple[float, float], ...], verdict: Determinacy
) -> None:
    """n of two runs was -11 to 20; the law has 0.002 to 5."""
    mean = combine("n", [Estimate(0.174, 0.186), Estimate(0.051, 0.02)])
    of_runs = [
        ResultRow(quantity="n", verdict=Determinacy.INTERVAL, lower=low, upper=high) for low, high in limits
    ]
    (row,) = series_rows({"n": mean}, {}, _PENDULUM, {"n": of_runs})
    assert row.verdict is verdict
    assert isnan(row.lower)
    assert isnan(row.upper) == (verdict is Determinacy.UNDETERMINED)
    # of a mean as uncertain, too
    (row,) = series_rows({"n": replace(mean, value=0.1, standard_uncertainty=0.1)}, {}, _PENDULUM)
    assert (row.verdict, isnan(row.lower)) == (Determinacy.UPPER_BOUND, True)


def test_a_limit_that_only_physics_sets_is_none_of_the_data() -> None:
    """Periods of which the profiles have no lower end were together 4.149 to 4.176 s; 4.071 was the truth."""
    found = [Estimate(4.1659, 0.0017), Estimate(4.1658, 0.0019)]
    row = ResultRow(quantity="period0_s", verdict=Determinacy.UPPER_BOUND, lower=0.0, upper=4.1681)
    (together,) = series_rows(
        {"period0_s": combine("period0_s", found)}, {}, _PENDULUM, {"period0_s": [row] * 2}
    )
    assert together.verdict is Determinacy.UPPER_BOUND
    assert together.lower == 0.0


def test_rows_are_found_by_name_and_by_symbol() -> None:
    row = ResultRow(quantity="period0_s", value=4.0, u=0.01, u_total=0.02, run="run-1")
    run = RunResults(record="run-1.mcap", table=(row,))
    session = SessionResults(runs=(RunResults(record="run-0.mcap"), run))
    assert run["T0"] is row
    assert session["period0_s"] is row
    with pytest.raises(ConfigurationError, match=r"'bb': no such result; there are period0_s"):
        session["bb"]
    of_series = replace(row, run="series")
    assert replace(session, series=Series(table=(of_series,)))["T0"] is of_series
    assert repr(session).splitlines()[2:] == ["  T₀ = 4.000 ± 0.020 s"]


def test_with_adhesion_the_whole_uncertainty_is_that_of_the_apparatus_too() -> None:
    """Each theory takes c, the load and the radius of the spot from the same run, and no other input."""
    table = analyse_record(SERIES / "run-1.mcap").table
    rows = {(row.quantity, row.fit): row for row in table}
    for name in ("surface_energy_table2_j_per_m2", "contact_radius_m"):
        hertz = rows[name, "exact"]
        for theory in ("JKR", "Maugis-Dugdale", "DMT"):
            row = rows[name, theory]
            assert row.u_total / row.value == pytest.approx(hertz.u_total / hertz.value, rel=0.02)


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


@pytest.mark.parametrize("verbose", [False, True])
def test_the_terminal_shows_the_whole_uncertainty_and_that_of_the_swings_alone_where_asked(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, verbose: bool
) -> None:
    caplog.set_level(logging.INFO if verbose else logging.WARNING, logger="rig.analysis.fit_tables")
    met = Verdict("lost spots", ok=True, measured="0 %", limit="1 %")
    wished = Verdict("beam", ok=True, reason="it is wide", remedy="focus it", measured="9 px", limit="12 px")
    failed = Verdict("end", ok=False, reason="it was cut", remedy="measure again", measured="", limit="whole")
    # E of the flat makes most of the doubt of b
    sources = (
        BudgetSource("flat_youngs_modulus_pa", "B", 1e9, 1e-13, 1e-4, 0.99),
        BudgetSource("swings", "A", nan, nan, 1e-5, 0.01),
    )
    whole = Budget(value=3.5e-3, standard_uncertainty=1e-4, sources=sources)
    rows = (*_RUN.table[:2], replace(_RUN.table[2], u_total=1e-4), *_RUN.table[3:])
    run = replace(_RUN, budget={"b": whole}, table=rows, conditions=(met, wished, failed))
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


def test_the_tables_of_a_run_have_bounds_per_cent_whole_numbers_and_the_one_mean_period() -> None:
    """What is not determined has no value by any method."""
    table = parameter_table(_RUN)
    rows = {row[0]: row[1:] for row in table.shown}
    assert table.head == ("", "value", "unit", "u of the swings", "Eqs. 5 and 6")
    assert rows["c"] == ["< 6.1 × 10⁻⁸ (95 %)", "", "", ""]
    assert rows["σ (Table 2's form)"][0] == "< 183 (95 %)"
    assert "±" in rows["b"][0]
    assert "±" in rows["b"][3]
    # the second of a free-running clock is known to some 60 ppm, the times of the half-cycles far better
    period = plain_row("mean_period_s", Estimate(4.16631, 0.0088), "run-1", "decay")
    exact = replace(_RUN.fits["exact"], mean_period_s=Estimate(4.158322870, 3.1e-7))
    run = replace(_RUN, table=(*_RUN.table, period), fits={**_RUN.fits, "exact": exact})
    rows = {row[0]: row[1:] for row in quality_table(run).shown}
    assert rows["mean period of the run"] == [period.text, period.text, "s"]
    assert rows["ARAE of the amplitudes, Eq. 8"] == ["–", "1.20", "%"]
    assert rows["degrees of freedom"] == ["0", "58", ""]


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
