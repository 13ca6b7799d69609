"""What is read from results.json is what the fit knows: of a measured series, and of decays in air."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from processing.fit import AIR, LinearisedFit, drift_effects
from processing.series import to_coordinates
from processing.units import ARCSEC_RAD
from rig.analysis import analyse_record
from rig.report import StatedCampaign, fit_model, runs_of_folders
from rig.report.campaign_input import FoundRun
from rig.report.likelihoods import compress

REFERENCE_RAD = 60 * ARCSEC_RAD


@pytest.mark.slow
@pytest.mark.usefixtures("verdicts")
def test_it_is_that_of_the_fit(measured_series: Path) -> None:
    run = analyse_record(measured_series / "run-1.mcap", ["fit.u_ageing=0.01"])
    fit, pendulum = run.fitted["exact"], run.pendulum
    assert pendulum is not None
    found, problem = compress(
        FoundRun(label="run-1", contact="glass", results_sha256="", run=run), REFERENCE_RAD, {}
    )
    assert found is not None, problem
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
        if source == "air" or source.startswith("misfit"):
            again += np.outer(column, column)
    u, u_again = np.sqrt(np.diag(whole)), np.sqrt(np.diag(again))
    assert np.all(u_again > 0.9 * u)
    assert np.all(u_again < 1.5 * u)


def test_a_measured_series_is_a_campaign(measured_series: Path) -> None:
    found = fit_model(runs_of_folders([measured_series]), StatedCampaign())
    (values,) = found.results.contacts.values()
    assert 0.9 < values["p"].value < 1.0
    assert found.results.simulated
    assert len(found.results.runs) == 2
    assert {"mass_kg", "arm_m"} <= set(found.results.shared)


def test_what_is_not_determined_is_left_out(measured_series: Path) -> None:
    (first, _) = runs_of_folders([measured_series])
    nothing = replace(first, run=replace(first.run, fits={}, problem="too short"))
    found, problem = compress(nothing, REFERENCE_RAD, {})
    assert found is None
    assert problem.endswith("left out: too short")
    with pytest.raises(Exception, match=r"no run can enter the campaign: .*too short"):
        fit_model([nothing], StatedCampaign())
