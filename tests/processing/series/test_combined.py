"""Series of runs are combined, averaged and compared; an outlying run is named."""

from dataclasses import replace
from functools import cache
from math import nan

import numpy as np
import pytest

from processing.contact.laws import PAPER
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import Evidence
from processing.fit.exact import fit_exact
from processing.fit.result import FitResult
from processing.fit.uncertainty import budgets
from processing.series import combine_runs, combined_limits
from processing.series.combined import combine
from tests.processing.fit.decays import decay, paper_pair
from tests.processing.fit.test_uncertainty import rig


@cache
def run(seed: int, **changes: float) -> FitResult:
    """The fit of a decay on glass, which runs share but for `changes`."""
    parameters, pendulum = paper_pair("glass_k8")
    parameters = replace(parameters, **changes)
    return fit_exact(decay(parameters, pendulum, noise_arcsec=0.005, seed=seed, last_arcsec=5), pendulum)


def runs(*seeds: int, **changes: float) -> list[FitResult]:
    return [run(seed, **changes) for seed in seeds]


def test_runs_that_agree_are_averaged_by_their_weights() -> None:
    combined = combine("c", [Estimate(1.0, 0.1), Estimate(1.05, 0.1), Estimate(0.97, 0.2)])
    weights = np.array([100, 100, 25])
    assert combined.between_runs == 0
    assert combined.value == pytest.approx(np.sum(weights * [1.0, 1.05, 0.97]) / 225)
    assert combined.standard_uncertainty == pytest.approx(1 / 15)
    assert combined.within_runs == pytest.approx(1 / 15)
    assert combined.degrees_of_freedom == 2
    # t for 2 degrees of freedom
    assert combined.expanded_uncertainty_95 == pytest.approx(4.302653 / 15, rel=1e-6)
    assert combined.p_homogeneous > 0.5


def test_runs_that_scatter_count_alike() -> None:
    x = [1.0, 2.0, 4.0]
    combined = combine("c", [Estimate(v, 0.01 * (k + 1)) for k, v in enumerate(x)])
    assert combined.value == pytest.approx(np.mean(x), rel=1e-3)
    assert combined.standard_uncertainty == pytest.approx(np.std(x, ddof=1) / np.sqrt(3), rel=1e-3)
    assert combined.between_runs == pytest.approx(np.std(x, ddof=1), rel=1e-3)
    assert combined.p_homogeneous < 1e-10


def test_parabolas_have_the_limits_of_their_mean() -> None:
    runs = [Estimate(1.0, 0.1), Estimate(1.05, 0.1), Estimate(0.97, 0.2)]
    mean = combine("c", runs)
    of_runs = [(Estimate(x, u), (x - 1.959964 * u, x + 1.959964 * u)) for x, u in runs]
    half = mean.expanded_uncertainty_95
    assert combined_limits(of_runs) == pytest.approx((mean.value - half, mean.value + half), rel=1e-4)


def test_limits_of_runs_cover_what_a_mean_of_them_misses() -> None:
    """Seven exponents by their profiles: a parabola makes those most certain that happen to be small."""
    runs = [
        (Estimate(0.174, 0.186), (0.058, 0.884)),
        (Estimate(0.096, 0.120), (nan, 1.45)),
        (Estimate(0.051, 0.012), (nan, 0.284)),
        (Estimate(0.056, 0.022), (0.040, nan)),
        (Estimate(0.115, 0.158), (nan, 1.35)),
        (Estimate(0.297, 0.712), (nan, 2.20)),
        (Estimate(0.100, 0.082), (nan, nan)),
    ]
    mean = combine("n", [run for run, _ in runs])
    assert mean.value + mean.expanded_uncertainty_95 < 0.092
    lower, upper = combined_limits(runs)
    assert 0.040 < lower < 0.092 < upper < 0.884
    assert np.isnan(combined_limits([(run, (low, nan)) for run, (low, _) in runs])[1])
    assert combined_limits(runs, logarithmic=True)[0] > lower


def test_what_is_known_of_the_air_is_shared_and_not_averaged_away() -> None:
    own, by_air = 0.1, 0.5
    found = [Estimate(1.0 + off, float(np.hypot(own, by_air))) for off in (-0.1, 0.0, 0.1, 0.0)]
    combined = combine("b", found, [by_air] * 4)
    assert combined.standard_uncertainty == pytest.approx(np.hypot(own / 2, by_air), rel=1e-6)
    assert combined.by_air == pytest.approx(by_air)
    # they scatter as their own uncertainties say, and not as the whole ones would
    assert combined.p_homogeneous == pytest.approx(0.572, abs=0.001)
    apart = combine("b", found, [by_air, by_air, -by_air, -by_air])
    assert apart.by_air == pytest.approx(0.0, abs=1e-12)
    assert apart.standard_uncertainty == pytest.approx(own / 2, rel=1e-6)


def test_the_interval_of_a_mean_is_students_of_what_scatters_and_the_normals_of_what_is_shared() -> None:
    """Of two runs, at 95 %: t of one degree is 12.706, and the normal's 1.960 (tables)."""
    found = combine("b", [Estimate(1.0, 5.0), Estimate(9.0, 5.0)], [4.0, 4.0])
    u = found.standard_uncertainty
    assert found.by_air == pytest.approx(4.0)
    assert found.own == pytest.approx((u**2 - 16.0) ** 0.5)
    assert found.own < u
    expected = ((12.706 * found.own) ** 2 + (1.960 * 4.0) ** 2) ** 0.5
    assert found.expanded_uncertainty_95 == pytest.approx(expected, rel=1e-4)


def test_the_doubt_of_the_air_is_in_a_series_as_in_each_run() -> None:
    """Turning points alone: b is as uncertain as the air is, whatever the number of runs."""
    parameters, pendulum = paper_pair("glass_k8", 1.7e-3)
    evidence = Evidence(drag_s=Estimate(1.7e-3, 0.8e-3))
    decays = [decay(parameters, pendulum, noise_arcsec=0.005, seed=seed, last_arcsec=10) for seed in range(2)]
    results = [fit_exact(points, pendulum, drag=True, evidence=evidence) for points in decays]
    series = combine_runs(results)
    for name in ("b", "drag_s"):
        each = [result.estimate(name).standard_uncertainty for result in results]
        assert series.parameters[name].standard_uncertainty > 0.9 * min(each)
    lines = {line.source: line for line in budgets(series.combined, rig())["b"].sources}
    assert lines["air"].type == "B"
    assert lines["air"].share > 0.5
    alone = {line.source: line for line in budgets(results[0], rig())["b"].sources}
    assert sum(line.share for line in alone.values()) == pytest.approx(1.0)
    assert alone["air"].share > 0.5
    # without what is known of the air the drag would be open
    assert results[0].information_gain["air"]["drag_s"] > 1.5


def test_a_series_is_better_than_its_runs_and_goes_on_into_the_budget() -> None:
    series = combine_runs(runs(0, 1, 2))
    parameters, _ = paper_pair("glass_k8")
    assert not series.disagreements
    for name in PAPER.names():
        combined = series.parameters[name]
        assert abs(combined.value - getattr(parameters, name)) < 4 * combined.standard_uncertainty
        assert len(combined.runs) == 3
    table = budgets(series.combined, rig())
    half_cycles = next(line for line in table["c"].sources if line.type == "A")
    assert half_cycles.u_source == pytest.approx(series.parameters["c"].standard_uncertainty)


def test_the_run_that_disagrees_is_named_and_of_two_both() -> None:
    results = [*runs(0, 1), run(2, c=15e-9)]
    series = combine_runs(results)
    assert {item.run for item in series.disagreements} == {3}
    c = next(item for item in series.disagreements if item.name == "c")
    assert c.deviation > 5
    assert series.parameters["c"].p_homogeneous < 1e-6
    assert series.parameters["c"].between_runs > 10 * series.parameters["c"].within_runs
    shuffled = combine_runs([results[0], results[2], results[1]])
    assert {item.run for item in shuffled.disagreements} == {2}
    assert {item.run for item in combine_runs([results[0], results[2]]).disagreements} == {1, 2}


def test_one_run_is_no_series() -> None:
    with pytest.raises(DataError, match="run"):
        combine_runs(runs(0))
    with pytest.raises(DataError, match="run"):
        combine("c", [Estimate(1.0, 0.1)])
    with pytest.raises(DataError, match="run 2 does not determine c"):
        combine("c", [Estimate(1.0, 0.1), Estimate(1.0, float("inf"))])
