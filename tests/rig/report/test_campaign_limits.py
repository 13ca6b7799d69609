"""A campaign with runs that bound a parameter, or cannot enter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from processing.estimate import Estimate
from processing.units import ARCSEC_RAD
from rig.report import StatedCampaign, fit_model, runs_of_folders, save_campaign
from rig.report.likelihoods import compress
from tests.rig.report.made_sessions import ENERGY_OVER_C, GLASS, run, session


def test_a_run_that_is_left_out_keeps_its_place_in_the_order(measured_series: Path) -> None:
    first, second = runs_of_folders([measured_series])
    nothing = replace(first, run=replace(first.run, fits={}, problem="too short"))
    (entered,) = fit_model([nothing, second], StatedCampaign()).posterior.runs
    assert entered.covariates["order"] == 1.0


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


def test_what_is_not_determined_is_left_out(measured_series: Path) -> None:
    (first, _) = runs_of_folders([measured_series])
    nothing = replace(first, run=replace(first.run, fits={}, problem="too short"))
    found, problem = compress(nothing, 60 * ARCSEC_RAD)
    assert found is None
    assert problem.endswith("left out: too short")
    with pytest.raises(Exception, match=r"no run can enter the campaign: .*too short"):
        fit_model([nothing], StatedCampaign())
