"""The drag of the air from runs that share a contact and differ in their vanes."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import Evidence, MeasuredAir, VanedRun, air_of_vanes, fit_exact, waveform_of
from processing.fit.refinement import DecayFit, fitted_twice
from processing.swing import half_cycles_of_blocks
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.processing.fit.frames import points_and_harmonics, seen_in_frames

DRAG_S, PER_M2_S, RATE = 1.7e-3, 0.025, 25.0
AREAS_M2 = (0.0, 0.07, 0.14)
PARAMETERS, PENDULUM = paper_pair("glass_k8")


def run_of(area_m2: float, seed: int, *, rougher: float = 1.0) -> VanedRun:
    """Frames of a pendulum in air, integrated, whose vanes make it slower, too; measured as in a session."""
    true = replace(
        PARAMETERS,
        drag_s=DRAG_S + PER_M2_S * area_m2,
        period0_s=PARAMETERS.period0_s * (1 + 0.3 * area_m2),
        b=rougher * PARAMETERS.b,
    )
    path = driven_path(true, PENDULUM, q=3e-9, seed=seed, frames_per_s=RATE, last_arcsec=25)[2]
    samples = seen_in_frames(path, 0.005 * ARCSEC, [seed, 3], RATE)
    decay = DecayFit(PENDULUM, evidence=Evidence(waveform_of(points_and_harmonics(samples)[1])))
    refined, fit = fitted_twice(half_cycles_of_blocks([samples]), [samples], decay)
    return VanedRun(decay.points(refined.half_cycles), fit, area_m2)


@pytest.fixture(scope="module")
def runs() -> list[VanedRun]:
    return [run_of(area, seed) for seed, area in enumerate(AREAS_M2)]


@pytest.fixture(scope="module")
def found(runs: list[VanedRun]) -> MeasuredAir:
    return air_of_vanes(runs, PENDULUM)


@pytest.mark.slow
def test_the_line_and_the_contact_are_those_of_all_runs(runs: list[VanedRun], found: MeasuredAir) -> None:
    for (value, u), true in ((found.drag_s, DRAG_S), (found.drag_per_area_s_per_m2, PER_M2_S)):
        assert abs(value - true) < 3.5 * u
        assert u < 0.03 * true
    for name, (value, u) in found.contact.items():
        assert abs(value - getattr(PARAMETERS, name)) < 3.5 * u
    alone = min(run.fit.estimate("drag_s").standard_uncertainty for run in runs)
    assert 0.4 * alone < found.drag_s.standard_uncertainty < 0.9 * alone
    assert (found.dof, found.u_inflation) == (11, max(1.0, (found.chi2 / 11) ** 0.5))
    assert found.p_value > 0.01
    for off, of_run in zip(found.residuals_s, found.run_drags_s, strict=True):
        assert abs(off) < 3.5 * of_run.standard_uncertainty < 1e-4


@pytest.mark.slow
def test_runs_that_share_no_contact_are_seen(runs: list[VanedRun]) -> None:
    apart = air_of_vanes([runs[0], run_of(AREAS_M2[-1], 9, rougher=1.1)], PENDULUM)
    assert apart.p_value < 1e-6
    assert apart.disagree
    assert apart.u_inflation > 2


@pytest.mark.slow
def test_a_scatter_that_chance_may_explain_enlarges_too(runs: list[VanedRun], found: MeasuredAir) -> None:
    """As if each run had taken the ground for quieter than it is: k was up to 1.3 u off, of many seeds."""
    quieter = (found.chi2 / (1.7 * found.dof)) ** 0.5
    quiet = [
        replace(run, fit=replace(run.fit, u_inflation=np.full(len(run.fit.names), quieter))) for run in runs
    ]
    doubted = air_of_vanes(quiet, PENDULUM)
    assert 0.01 < doubted.p_value < 0.2
    assert not doubted.disagree
    assert doubted.u_inflation == pytest.approx(1.7**0.5, rel=0.05)
    # what was left out of the stated noise is back
    for one, whole in (
        (doubted.drag_s, found.drag_s),
        (doubted.drag_per_area_s_per_m2, found.drag_per_area_s_per_m2),
    ):
        unscaled = whole.standard_uncertainty / found.u_inflation
        assert one.standard_uncertainty == pytest.approx(unscaled * quieter * doubted.u_inflation, rel=0.05)


def test_what_measures_no_air_is_refused(runs: list[VanedRun]) -> None:
    vacuum = replace(runs[1], fit=fit_exact(runs[1].points, PENDULUM))
    known = replace(runs[1], fit=replace(runs[1].fit, evidence=Evidence(drag_s=Estimate(1e-3, 1e-4))))
    for run, words in ((vacuum, "run 2 was fitted without a drag"), (known, "knowledge of the air")):
        with pytest.raises(DataError, match=words):
            air_of_vanes([runs[0], run], PENDULUM)
    with pytest.raises(DataError, match="two areas"):
        air_of_vanes([runs[0], runs[0]], PENDULUM)
