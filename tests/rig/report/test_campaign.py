"""`rig compare`: from folders, or an archive, to the files of a paper, also as the page shows it."""

import json
import re
import shlex
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.ambient import AmbientConditions, other_unit_warning
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from processing.fit import AIR, Budget, LinearisedFit, drift_effects
from processing.fit.uncertainty import BudgetSource
from processing.series import EndSide, Form, to_coordinates
from processing.units import ARCSEC_RAD
from rig.analysis import RunResults, TableDecay, analyse_record, read_results
from rig.analysis.result_rows import Determinacy, ResultRow
from rig.archive.session_rows import session_rows
from rig.report import StatedCampaign, fit_model, read_campaign, runs_of_folders, save_campaign
from rig.report.campaign_input import CandidateRun, runs_of_archive, stated_model
from rig.report.campaign_page import campaign_tables, decays_table, effects_table
from rig.report.likelihoods import _bound, compress
from tests.rig.command_line import SAMPLES, rig
from tests.rig.report.made_sessions import (
    ENERGY_OVER_C,
    GLASS,
    NAMES,
    U_ARM_M,
    humid_campaign,
    run,
    session,
)

REFERENCE_RAD = 60 * ARCSEC_RAD
STATED = """
parameters = ["b", "p", "c"]
change_points = ["b"]

[[effect]]
parameter = "c"
covariate = "humidity_percent"
form = "linear"
reference = 45
"""


@pytest.mark.slow
def test_from_folders_to_the_files_of_a_paper(tmp_path: Path) -> None:
    humid_campaign(tmp_path, slope=-0.03, bad=True)
    (tmp_path / "campaign.toml").write_text(STATED)
    done = rig(
        "compare", "monday", "tuesday", "--model", "campaign.toml", "-o", "out", cwd=tmp_path, figures=True
    )
    assert done.returncode == 0, done.stderr
    assert "tuesday/run-2 is a bad run" in done.stderr + done.stdout
    tree = json.loads((tmp_path / "out" / "campaign.json").read_text())
    (effect,) = tree["effects"]
    value, u = effect["slope"]["value"], effect["slope"]["standard_uncertainty"]
    assert abs(value + 0.03) < 3 * u < 0.015
    assert effect["seen"]
    assert [run["bad"] > 0.9 for run in tree["runs"]].count(True) == 1
    results = read_results(tmp_path / "monday")
    assert tree["runs"][0]["sha256"] == results.runs[0].sha256
    assert set(tree["contacts"]["monday"]) == {"b", "p", "c", "surface_energy_table2_j_per_m2"}
    files = tmp_path / "out" / "campaign"
    assert (files / "covariates.svg").stat().st_size > 5_000
    assert r"\begin{tabular}" in (files / "contacts.tex").read_text()
    page = (tmp_path / "out" / "campaign.html").read_text()
    assert "What limits the answer now" in page
    assert "without priors" in page
    again = rig("compare", "monday", "-o", "out", cwd=tmp_path)
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_what_the_arm_does_counts_once(tmp_path: Path) -> None:
    """c goes as the arm, which is known to 0.1 %: here made so uncertain that it is all that counts."""
    for count in (4, 16):
        (folder,) = humid_campaign(tmp_path / str(count), slope=0.0, count=count)[:1]
        found = fit_model(runs_of_folders([folder]), StatedCampaign(parameters=("c",)))
        shared = found.results.shared["arm_m"]
        assert shared.standard_uncertainty == pytest.approx(1.0, abs=0.12)
        values, shares = found.results.contacts["monday"], found.results.budgets["monday"]["c"]
        assert sum(shares.values()) == pytest.approx(1.0)
        assert [*shares.values()] == sorted(shares.values(), reverse=True)
        c, energy = values["c"], values["surface_energy_table2_j_per_m2"]
        assert shares["arm_m"] ** 0.5 * c.standard_uncertainty / c.value == pytest.approx(U_ARM_M, rel=0.25)
        assert abs(c.value - GLASS[2]) < 4 * c.standard_uncertainty
        assert energy.value == pytest.approx(ENERGY_OVER_C * c.value, rel=2e-3)


def test_what_runs_share_cancels_between_contacts(tmp_path: Path) -> None:
    """The second contact is rougher by 5 %: the arm that both share is no part of the doubt."""
    rng, rough = np.random.default_rng(4), GLASS.copy()
    rough[[0, 2]] *= np.exp([0.05, 0.5])
    folders = [
        session(tmp_path / name, [run(number, truth, rng) for number in range(1, 9)])
        for name, truth in (("smooth", GLASS), ("rough", rough))
    ]
    campaign = fit_model(runs_of_folders(folders), StatedCampaign(parameters=("b", "p", "c")))
    (table,) = [table for table in campaign_tables(campaign) if table.name == "differences"]
    assert [row[:2] for row in table.shown] == [["smooth − rough", "ln b"], ["smooth − rough", "ln c"]]
    by = {one.parameter: one for one in campaign.results.differences}
    for name, truth in (("b", -0.05), ("p", 0.0), ("c", -0.5)):
        value, u = by[name].difference
        assert abs(value - truth) < 3 * u
        assert by[name].lower_95 < value < by[name].upper_95
    assert [by[name].seen for name in ("b", "p", "c")] == [True, False, True]
    # 8 runs of 10 % each and their scatter, without the arm's own u
    assert by["c"].difference.standard_uncertainty < 0.12


def test_a_single_run_of_each_contact_does_not_tell_them_apart(tmp_path: Path) -> None:
    """Runs of one contact scatter by far more than their own u: 9 u were a difference of contacts."""
    rough, rng = GLASS.copy(), np.random.default_rng(5)
    rough[0] *= 1.05
    one, other = (
        session(tmp_path / name, [run(1, truth, rng)]) for name, truth in (("a", GLASS), ("b", rough))
    )
    many = session(tmp_path / "many", [run(number, GLASS, rng) for number in range(1, 9)])
    for folders, sure in (((one, other), False), ((many, other), True)):
        found = fit_model(runs_of_folders(folders), StatedCampaign(parameters=("b", "p"))).results
        (of_b,) = [one for one in found.differences if one.parameter == "b"]
        assert of_b.seen == sure, "the runs of the many show how runs scatter"


def compressed(one: RunResults) -> Any:
    """The likelihood of a run's results."""
    candidate = CandidateRun(label="run-1", contact="glass", results_sha256="", run=one)
    found, problem = compress(candidate, REFERENCE_RAD)
    assert found is not None, problem
    return found


def test_a_likelihood_is_that_of_its_results() -> None:
    one = run(1, GLASS, np.random.default_rng(3))
    likelihood = compressed(one)
    assert likelihood.names == NAMES
    fit = one.fits["exact"]
    (c, u_c), (_, u_p) = fit.estimate("c"), fit.estimate("p")
    assert likelihood.u("c") == pytest.approx(u_c / c, rel=0.01)
    assert likelihood.u("p") == pytest.approx(u_p, rel=0.01)
    # a longer arm than was thought makes the values as they are seen too large
    assert likelihood.shared["arm_m"][2] == pytest.approx(U_ARM_M, rel=1e-6)
    assert likelihood.covariates["humidity_percent"] == 45.0

    # what is known of the air is shared by runs, too
    lines = (
        BudgetSource("swings", "A", np.nan, np.nan, 6e-5, 0.36),
        BudgetSource("air", "B", np.nan, np.nan, 8e-5, 0.64),
    )
    with_drag = replace(fit, parameters={**fit.parameters, "drag_s": Estimate(2e-3, 1e-4)})
    budget = {**one.budget, "drag_s": Budget(value=2e-3, standard_uncertainty=1e-4, sources=lines)}
    found = compressed(replace(one, fits={"exact": with_drag}, budget=budget))
    at = found.names.index("drag_s")
    assert found.covariance[at, at] / found.shared["air"][at] ** 2 == pytest.approx(0.36 / 0.64)
    # and so is what their law does not describe
    lines = (lines[0], replace(lines[1], source="discrepancy", type="A"))
    budget = {**one.budget, "p": Budget(value=0.944, standard_uncertainty=1e-3, sources=lines)}
    found = compressed(replace(one, budget=budget))
    assert found.covariance[1, 1] == pytest.approx(0.36 * likelihood.covariance[1, 1])
    assert found.shared["discrepancy of p"][1] ** 2 == pytest.approx(0.64 * likelihood.covariance[1, 1])


@pytest.mark.parametrize(
    ("value", "u", "is_bounded"), [(1e-8, 6e-9, True), (-2e-9, 6e-9, True), (1e-8, 4e-9, False)]
)
def test_what_a_run_hardly_determines_is_a_bound(value: float, u: float, is_bounded: bool) -> None:
    """Results without a row of c: the bound is its value plus two u."""
    one = run(1, GLASS, np.random.default_rng(3))
    fit = one.fits["exact"]
    parameters = {**fit.parameters, "c": Estimate(value, u)}
    found = compressed(replace(one, table=(), fits={"exact": replace(fit, parameters=parameters)}))
    assert ("c" in found.names) is not is_bounded
    if is_bounded:
        bound = found.bounds["c"]
        assert bound.side is EndSide.UPPER
        # its likelihood is one at the limit less its softness, and falls over as much
        assert bound.limit + bound.softness == pytest.approx(np.log(value + 2 * u))
    row = ResultRow(quantity="c", lower=2e-9, verdict=Determinacy.LOWER_BOUND)
    bound = _bound("c", value, u, row)
    assert bound is not None
    assert (bound.limit, bound.side) == (np.log(2e-9), EndSide.LOWER)


def test_without_priors_stands_beside(tmp_path: Path) -> None:
    folders = humid_campaign(tmp_path, slope=0.0)
    stated = StatedCampaign.model_validate({"parameters": ["p"], "prior": {"p": {"value": 0.96, "u": 1e-4}}})
    value = fit_model(runs_of_folders(folders), stated).results.contacts["monday"]["p"]
    assert value.value > 0.955
    assert value.without_priors.value == pytest.approx(0.944, abs=0.002)
    of_c = StatedCampaign.model_validate({"parameters": ["c"], "prior": {"c": {"value": 1e-8, "u": 2e-9}}})
    level = stated_model(of_c, REFERENCE_RAD, []).levels["c"]
    assert tuple(level) == pytest.approx((np.log(1e-8), 0.2))


EFFECT = '[[effect]]\nparameter = "c"\nform = "linear"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('parameters = ["q"]', "parameters: there is no 'q'"),
        ('[[effect]]\nparameter = "c"\nform = "linear"', "covariate: is missing"),
        ('[[effect]]\nparameter = "c"\nform = "cubic"\ncovariate = "order"', "effect 1: form"),
        (
            '[[effect]]\nparameter = "c"\nform = "linear"\ncovariate = "phase_of_moon"',
            "there is no covariate 'phase_of_moon'; a campaign has humidity_percent",
        ),
        (EFFECT + 'covariate = "pressure_pa"', "pressure_pa: known of 0"),
        (EFFECT + 'covariate = "order"\nreference = nan', "effect 1: reference"),
        (
            EFFECT + 'covariate = "order"\ncontact = "tuesday"',
            "'tuesday': no such contact; the runs",
        ),
        (2 * (EFFECT + 'covariate = "order"\n'), "effect: the same is stated twice"),
        ('parameters = ["c", "c"]', "parameters: the same is stated twice"),
        ("[size]\nb = -0.5", "size.b"),
        ("[size]\nbb = 0.5", "size.bb: there is no such parameter"),
        ("[prior.p]\nvalue = 1", "prior.p.u: is missing"),
        ("draw = 3", "draw: unknown key; did you mean draws?"),
    ],
)
def test_what_is_stated_wrongly_is_said_in_a_line(tmp_path: Path, text: str, said: str) -> None:
    session(tmp_path / "monday", [run(k, GLASS, np.random.default_rng(k)) for k in (1, 2)])
    (tmp_path / "campaign.toml").write_text(text)
    done = rig("compare", "monday", "--model", "campaign.toml", cwd=tmp_path)
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_growth_within_runs_that_is_not_known_is_said_and_so_is_a_bad_run(tmp_path: Path) -> None:
    folders = humid_campaign(tmp_path, bad=True)
    growing = {"parameters": ["b", "p", "c"], "effect": [{"parameter": "friction", "form": "during"}]}
    found = fit_model(runs_of_folders(folders), StatedCampaign.model_validate(growing))
    assert "rig fit --set fit.u_ageing=0.01" in " ".join(found.results.warnings)
    bad = [warning.split(" is a bad run ")[0] for warning in found.results.warnings if "bad run" in warning]
    assert bad == ["tuesday/run-2"]


def test_what_some_runs_were_measured_under_is_not_known_is_said(tmp_path: Path) -> None:
    """Half of the humidities were guessed without a word."""
    rng = np.random.default_rng(5)
    runs = [run(number, GLASS, rng, humidity_percent=30.0 + 5 * number) for number in range(1, 7)]
    runs[3:] = [replace(one, ambient=None) for one in runs[3:]]
    folder = session(tmp_path / "monday", runs)
    path = tmp_path / "campaign.toml"
    path.write_text(STATED)
    found = fit_model(runs_of_folders([folder]), read_campaign(path)).results
    (said,) = [warning for warning in found.warnings if "humidity" in warning]
    assert said.startswith("humidity_percent is not known of 3 of 6 runs (monday/run-4, monday/run-5, ")
    path.write_text('parameters = ["c"]')
    found = fit_model(runs_of_folders([folder]), read_campaign(path)).results
    assert not any("humidity" in warning for warning in found.warnings)


def test_a_chance_below_that_of_one_draw_is_a_limit(tmp_path: Path) -> None:
    """An effect of 12 u had "a chance of 0.0045": one over the draws that count, of which none lay beyond."""
    path = tmp_path / "campaign.toml"
    path.write_text(STATED)
    chances = {}
    for slope in (-0.06, 0.0):
        folders = humid_campaign(tmp_path / str(slope), slope=slope)
        found = fit_model(runs_of_folders(folders), read_campaign(path)).results
        table = effects_table(found)
        assert table is not None
        chances[slope] = str(table.shown[0][2])
        assert found.effects[0].chance_is_limit == (slope != 0)
    assert chances[-0.06].startswith("< ")
    assert not chances[0.0].startswith("<")


def test_a_folder_or_a_run_that_is_there_twice_counts_once(tmp_path: Path) -> None:
    """Both had one label, so that nothing was noticed, and uncertainties were too small by sqrt(2)."""
    folder = session(tmp_path / "monday", [run(1, GLASS, np.random.default_rng(6))])
    for again in (folder, folder / "results.json", tmp_path / "monday" / ".." / "monday"):
        named = r"run-1: (its folder is named twice|is the run of .*run-1 \(same hash\))"
        with pytest.raises(ConfigurationError, match=named):
            runs_of_folders([folder, again])
    first = run(1, GLASS, np.random.default_rng(1))
    session(tmp_path / "tuesday", [first, replace(first, record="run-9.mcap")])
    with pytest.raises(ConfigurationError, match=r"tuesday/run-9: is the run of tuesday/run-1 \(same hash\)"):
        runs_of_folders([tmp_path / "tuesday"])


def test_decays_of_one_table_are_runs(tmp_path: Path) -> None:
    """They share the table's hash; the archive lists each by its own, by which it is found again."""
    rng = np.random.default_rng(1)
    decays = [
        replace(run(number, GLASS, rng), record="two.csv", sha256="ab" * 32, decay=place)
        for number, place in enumerate(
            [TableDecay(began_s=1.0, ended_s=50.0), TableDecay(began_s=60.0, ended_s=90.0)], start=1
        )
    ]
    folder = session(tmp_path / "two", decays)
    assert [one.label for one in runs_of_folders([folder])] == ["two/two", "two/two-decay-2"]
    listed = [
        (row["sha256"], row["run"], "glass", str(folder), row["results"]) for row in session_rows(folder)[0]
    ]
    found = runs_of_archive(listed)
    began = {one.label: one.run.decay.began_s for one in found if one.run.decay is not None}
    assert began == {"two/two": 1.0, "two/two-decay-2": 60.0}


def test_a_campaign_of_nothing_or_of_what_excludes_each_other_is_refused(tmp_path: Path) -> None:
    folder = session(tmp_path / "monday", [run(1, GLASS, np.random.default_rng(1))])
    for words, said in (
        (("--where", "b > 0"), "rig compare needs runs"),
        (("no-folder",), "no-folder: no such file or folder"),
        ((folder, "--where", "b > 0"), "has no effect without --archive"),
        ((folder, "--archive", "a"), "exclude each other"),
    ):
        done = rig("compare", *words, cwd=tmp_path)
        assert done.returncode == 2
        assert said in done.stderr


@pytest.mark.slow
def test_runs_of_an_archive(tmp_path: Path) -> None:
    for name in ("first", "series"):
        shutil.copytree(SAMPLES / name, tmp_path / name)
    added = rig("archive", "add", "first", "series", "--archive", "catalogue", cwd=tmp_path)
    assert added.returncode == 0, added.stderr
    (tmp_path / "campaign.toml").write_text('parameters = ["p"]')
    words = ("compare", "--archive", "catalogue", "--model", "campaign.toml")
    done = rig(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "2 runs" in done.stdout
    none = rig(*words, "--where", "b > 1e9", cwd=tmp_path)
    assert none.returncode == 2
    assert "no run with results meets it" in none.stderr


def test_a_night_is_one_contact(tmp_path: Path) -> None:
    humid_campaign(tmp_path / "night")
    found = runs_of_folders([tmp_path / "night"])
    assert {one.contact for one in found} == {"night"}
    assert [found[0].label, found[-1].label] == ["night/monday/run-1", "night/tuesday/run-6"]
    assert "night" in rig("compare", tmp_path / "night").stdout


ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "many-runs.md").read_text(encoding="utf-8")
TEXT = PAGE.partition("\n## One model of many runs\n")[2].partition("\n## ")[0]


@pytest.mark.slow
def test_the_commands_and_the_file_of_the_page(tmp_path: Path) -> None:
    humid_campaign(tmp_path / "runs")
    ((name, block),) = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / name).write_text(block, encoding="utf-8")
    alone, folders, of_archive = map(shlex.split, re.findall(r"^ {4}rig (.*)$", TEXT, re.MULTILINE))
    for words in (alone, folders):
        done = rig(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    tree = json.loads((tmp_path / "campaigns" / "glass" / "campaign.json").read_text())
    assert tree["effects"][0]["margin"] == 0.3
    assert tree["changes"][0]["parameter"] == "c"
    # records with humidities and samples take minutes to measure: the words alone are checked here
    shutil.copytree(SAMPLES / "first", tmp_path / "runs" / "first")
    assert rig("archive", "add", "runs/first", cwd=tmp_path).returncode == 0
    none = rig(*of_archive, cwd=tmp_path)
    assert none.returncode == 2
    assert "no run with results meets it" in none.stderr


def test_forms_and_covariates_that_are_named_exist() -> None:
    forms = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE))
    assert forms == set(map(str, Form))
    named = {field.name for field in fields(AmbientConditions)} - {"temperature_change_k"}
    assert all(f"`{name}`" in TEXT for name in named)


@pytest.mark.slow
@pytest.mark.usefixtures("verdicts")
def test_it_is_that_of_the_fit(measured_series: Path) -> None:
    run = analyse_record(measured_series / "run-1.mcap", ["fit.u_ageing=0.01"])
    fit, pendulum = run.fitted["exact"], run.pendulum
    assert pendulum is not None
    found = compressed(run)
    names = found.names
    assert {"b", "p", "gamma_pa"} <= set(names)
    at = [fit.names.index(name) for name in names]
    there, to = to_coordinates(names, fit.values[at], REFERENCE_RAD)
    np.testing.assert_allclose(found.values, there)
    # ageing: the budget's signed slope is the fit's own
    drifts = drift_effects(LinearisedFit.of(run.points, pendulum, fit))
    by = to @ (drifts["ageing"] + drifts["adhesion_ageing"])[at]
    assert found.by_growth is not None
    np.testing.assert_allclose(found.by_growth, by, rtol=0.02, atol=1e-6)
    # the run's own part and what it shares are the fit's covariance again
    whole = to @ fit.covariance[np.ix_(at, at)] @ to.T
    again = found.covariance.copy()
    if AIR in fit.terms:
        air = to @ fit.terms[AIR][at, 0]
        if "air" in found.shared:
            sign = np.sign(air @ found.shared["air"])
            np.testing.assert_allclose(
                sign * found.shared["air"], air, rtol=0.1, atol=0.05 * float(np.max(np.abs(air)))
            )
    for source, column in found.shared.items():
        if source == "air" or source.startswith("discrepancy"):
            again += np.outer(column, column)
    u, u_again = np.sqrt(np.diag(whole)), np.sqrt(np.diag(again))
    assert np.all(u_again > 0.9 * u)
    assert np.all(u_again < 1.5 * u)


def test_a_humidity_in_another_unit_than_the_others_is_said() -> None:
    runs = {"a": 41.0, "b": 0.45, "c": 50.0, "d": 58.0}
    assert other_unit_warning("humidity_percent", runs).startswith(
        "humidity_percent is 0.45 of b, and 41 to 58"
    )
    assert other_unit_warning("humidity_percent", {"a": 5.0, "b": 45.0, "c": 58.0}) == ""


def test_a_measured_series_is_a_campaign_and_a_run_without_a_fit_keeps_its_place_in_the_order(
    measured_series: Path,
) -> None:
    first, second = runs_of_folders([measured_series])
    found = fit_model([first, second], StatedCampaign()).results
    (values,) = found.contacts.values()
    assert 0.9 < values["p"].value < 1.0
    assert found.simulated
    assert found.warnings[0].startswith("SIMULATED: runs come from the simulated rig")
    assert {"mass_kg", "arm_m"} <= set(found.shared)
    titles = [
        decays_table([replace(first, run=replace(first.run, simulated=simulated))]).title
        for simulated in (True, False)
    ]
    assert titles == ["SIMULATED: decays", "Decays"]
    nothing = replace(first, run=replace(first.run, fits={}, problem="too short"))
    (entered,) = fit_model([nothing, second], StatedCampaign()).posterior.runs
    assert entered.covariates["order"] == 1.0
    with pytest.raises(Exception, match=r"no run can enter the campaign: .*left out: too short"):
        fit_model([nothing], StatedCampaign())


def test_a_contact_that_is_only_bounded_has_the_runs_limit_and_differs_on_one_side(tmp_path: Path) -> None:
    """Its band ended far below the limit of its runs, and it differed from whatever lay below that."""
    rng, folders = np.random.default_rng(6), []
    rough, smooth = GLASS.copy(), GLASS.copy()
    rough[2], smooth[2] = 1e-7, 1e-10
    for name, truth in (("rough", rough), ("smooth", smooth), ("bounded", GLASS)):
        runs = [run(number, truth, rng) for number in range(1, 5)]
        if name == "bounded":
            fits = [one.fits["exact"] for one in runs]
            # c is below 1e-8 by value and two u
            wide = [replace(fit, parameters={**fit.parameters, "c": Estimate(2e-9, 4e-9)}) for fit in fits]
            runs = [replace(one, fits={"exact": fit}) for one, fit in zip(runs, wide, strict=True)]
        folders.append(session(tmp_path / name, runs))
    slope = {"parameter": "c", "covariate": "order", "form": "linear"}
    stated = StatedCampaign.model_validate({"parameters": ("p", "c"), "effect": [slope]})
    save_campaign(fit_model(runs_of_folders(folders[2:]), stated), tmp_path / "campaign")
    found = fit_model(runs_of_folders(folders), StatedCampaign(parameters=("p", "c"))).results
    for key, factor in (("c", 1.0), ("surface_energy_table2_j_per_m2", ENERGY_OVER_C)):
        of_c = found.contacts["bounded"][key]
        assert np.isnan(of_c.value)
        assert np.isnan(of_c.without_priors.value)
        assert of_c.lower_95 == 0.0
        assert 0.5e-8 * factor < of_c.upper_95 < 2e-8 * factor
    assert set(found.budgets["rough"]) - set(found.budgets["bounded"]) == {"c"}, 'it was all "between runs"'
    for one in found.runs:
        assert np.isnan(one.together["c"].value) == (one.contact == "bounded"), "by the prior of the level"
    by = {(one.first, one.second): one for one in found.differences if one.parameter == "c"}
    assert by["rough", "bounded"].seen
    assert by["rough", "bounded"].lower_95 > 1
    assert np.isnan(by["rough", "bounded"].difference.value)
    assert not by["smooth", "bounded"].seen
    assert by["smooth", "bounded"].chance > 0.5
    assert by["rough", "bounded"].upper_95 == np.inf


def test_a_prior_within_the_margin_is_no_evidence_that_nothing_depends(tmp_path: Path) -> None:
    """All runs lie beyond the step: of an effect of which they say nothing it was said that there is none."""
    rng = np.random.default_rng(7)
    folder = session(tmp_path / "glass", [run(number, GLASS, rng) for number in range(1, 9)])
    step = {"parameter": "p", "covariate": "humidity_percent", "form": "step", "margin": 0.05}
    slope = {"parameter": "p", "covariate": "order", "form": "linear", "margin": 0.05}
    stated = {"parameters": ("b", "p"), "effect": [{**step, "reference": 40}, slope]}
    found = fit_model(runs_of_folders([folder]), StatedCampaign.model_validate(stated)).results
    beyond, flat = found.effects
    assert beyond.equivalent < 0.5
    assert flat.equivalent > 0.95, "eight runs of 0.001 show it"
