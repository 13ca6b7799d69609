"""A series of made-up runs returns what is true, as uncertain as it is."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import DataError
from processing.estimate import Estimate
from processing.series import (
    FRICTION,
    ORDER,
    Bound,
    CompressedRun,
    Effect,
    EndSide,
    Form,
    LatentNumber,
    SeriesModel,
    find_change,
    fit_series,
    parameters,
    sample_series,
    to_coordinates,
)
from processing.series.posterior import split_r_hat
from tests.processing.series.simulated_series import AIR, NAMES, World, made

CENTRE = np.array([-5.6, 0.94, -18.4])
SCATTER = np.array([0.02, 0.002, 0.1])
HUMIDITY = Effect(parameter="c", covariate="humidity_percent", form=Form.LINEAR, reference=45.0)
C = LatentNumber("contact", "c", "sample")


def world(**changes: object) -> World:
    return replace(World(levels={"sample": CENTRE}, scatter=SCATTER), **changes)  # type: ignore[arg-type]


def plain_run(
    value: float, u: float, *, label: str = "run", covariates: dict[str, float] | None = None
) -> CompressedRun:
    return CompressedRun(
        label=label, contact="sample", names=("c",), values=np.array([value]), covariance=np.array([[u**2]]),
        covariates=covariates or {},
    )  # fmt: skip


def still_model(names: tuple[str, ...] = ("c",), **fields: object) -> SeriesModel:
    """Levels that are hardly known beforehand, and a scatter between runs that is none."""
    levels = {name: Estimate(level, 100.0) for name, level in zip(NAMES, CENTRE, strict=True)}
    sizes = dict.fromkeys(NAMES, 1e-6) | {FRICTION: 0.2}
    return SeriesModel(names=names, sizes=sizes, levels=levels, **fields)  # type: ignore[arg-type]


def test_without_scatter_it_is_the_weighted_mean() -> None:
    runs = [plain_run(value, u) for value, u in ((-18.1, 0.1), (-18.4, 0.2), (-18.2, 0.15), (-18.3, 0.1))]
    found = fit_series(runs, still_model(bad_run_chance=0.0))
    weight = np.array([0.1, 0.2, 0.15, 0.1]) ** -2.0
    mean = float(weight @ [-18.1, -18.4, -18.2, -18.3] / weight.sum())
    value, u = found.estimate(C)
    assert value == pytest.approx(mean, abs=0.1 * weight.sum() ** -0.5)
    assert u == pytest.approx(weight.sum() ** -0.5, rel=0.08)


def test_what_runs_share_does_not_shrink_with_their_number() -> None:
    for count in (10, 40):
        found = fit_series(made(world(), count, np.random.default_rng(1)).runs, SeriesModel(names=NAMES))
        of_levels = [found.estimate(LatentNumber("contact", name, "sample")) for name in NAMES]
        assert all(one.standard_uncertainty > 0.9 * abs(air) for one, air in zip(of_levels, AIR, strict=True))
        # nothing in these runs tells the air: it stays as it was known
        of_air = found.estimate(LatentNumber("shared", "air"))
        assert of_air.standard_uncertainty == pytest.approx(1.0, abs=0.12)


def test_a_slope_is_found_and_none_is_invented() -> None:
    slope = -0.012
    wet = world(moved=lambda _, x: np.array([0, 0, slope * (x["humidity_percent"] - 45)]))
    model = SeriesModel(names=NAMES, effects=(HUMIDITY,))
    found = fit_series(made(wet, 20, np.random.default_rng(2)).runs, model)
    level = LatentNumber("effect", HUMIDITY.label)
    value, u = found.estimate(level)
    assert abs(value - slope) < 3 * u < 0.012
    assert found.chance(found.draws(level)) * 3 < 0.05
    dry = fit_series(made(world(), 20, np.random.default_rng(3)).runs, model)
    none = dry.draws(level)
    assert dry.chance(none) > 0.05
    # equivalence needs a narrow band
    assert dry.below(np.abs(none), 1.0) > 0.999
    assert dry.below(np.abs(none), 1e-4) < 0.5


def test_a_bad_run_is_named_and_does_little() -> None:
    runs = list(made(world(), 15, np.random.default_rng(4)).runs)
    without = fit_series(runs, SeriesModel(names=NAMES))
    assert without.bad.max() < 0.3
    runs[6] = replace(runs[6], values=runs[6].values + np.array([1.0, 0.0, 3.0]))
    found = fit_series(runs, SeriesModel(names=NAMES))
    assert found.bad[6] > 0.95
    assert np.sort(found.bad)[-2] < 0.3
    before, after = without.estimate(C), found.estimate(C)
    assert abs(after.value - before.value) < 0.5 * before.standard_uncertainty
    assert found.estimate(LatentNumber("between runs", "c")).value < 0.3


def test_a_bound_pulls_as_far_as_it_reaches() -> None:
    runs = [plain_run(-18.0, 0.3), plain_run(-18.0, 0.3), plain_run(-18.0, 0.3)]
    bound = CompressedRun(
        label="bounded", contact="sample", names=(), values=np.empty(0), covariance=np.empty((0, 0)),
        bounds={"c": Bound(-18.4, EndSide.UPPER, 0.05)},
    )  # fmt: skip
    model = still_model()
    found = fit_series([*runs, bound], model)
    free, bounded = fit_series(runs, model).estimate(C), found.estimate(C)
    assert free.value == pytest.approx(-18.0, abs=0.02)
    assert bounded.value < -18.3
    far = replace(bound, bounds={"c": Bound(-15.0, EndSide.UPPER, 0.05)})
    assert fit_series([*runs, far], model).estimate(C).value == pytest.approx(free.value, abs=0.02)


def test_an_unknown_humidity_costs_and_does_not_mislead() -> None:
    slope, rng = -0.02, np.random.default_rng(5)
    wet = world(moved=lambda _, x: np.array([0, 0, slope * (x["humidity_percent"] - 45)]))
    runs = made(wet, 24, rng).runs
    none = [
        replace(run, covariates={key: x for key, x in run.covariates.items() if key != "humidity_percent"})
        if place % 2
        else run
        for place, run in enumerate(runs)
    ]
    model = SeriesModel(names=NAMES, effects=(HUMIDITY,))
    level = LatentNumber("effect", HUMIDITY.label)
    best, found = (fit_series(some, model).estimate(level) for some in (runs, none))
    assert found.standard_uncertainty > 1.1 * best.standard_uncertainty
    assert abs(found.value - slope) < 3 * found.standard_uncertainty


def test_an_unknown_side_of_a_step_costs_and_does_not_mislead() -> None:
    """Runs of which nobody knows on which side they were: that of the mean is a guess, not knowledge."""
    rng = np.random.default_rng(12)
    step = Effect(parameter="c", covariate="humidity_percent", form=Form.STEP, reference=45.0)
    wet = 1.0  # ln c above 45 %
    found = made(
        world(moved=lambda _, x: np.array([0, 0, wet * (x["humidity_percent"] >= 45.0)])), 24, rng
    ).runs
    humid = [run for run in found if run.covariates["humidity_percent"] >= 45.0]
    dry = [run for run in found if run not in humid]
    known = [*dry[:9], *humid[:4]]  # their mean is dry
    assert np.mean([run.covariates["humidity_percent"] for run in known]) < 45.0
    unknown = [replace(run, covariates={}) for run in humid[4:8]]
    model = SeriesModel(names=NAMES, effects=(step,), sizes={"c": 1.0})
    level = LatentNumber("effect", step.label)
    told, mixed = (fit_series(runs, model).estimate(level) for runs in (known, [*known, *unknown]))
    assert abs(told.value - wet) < 2 * told.standard_uncertainty
    assert abs(mixed.value - wet) < 2 * mixed.standard_uncertainty
    assert mixed.standard_uncertainty < 1.5 * told.standard_uncertainty


def test_a_change_is_found_where_it_is() -> None:
    cleaned = world(
        moved=lambda i, _: np.array([0, 0, 0.6 * (i >= 9)]), scatter=np.array([0.02, 0.002, 0.05])
    )
    runs = made(cleaned, 16, np.random.default_rng(6), names=("c",)).runs
    found = find_change(runs, SeriesModel(names=("c",)), "c")
    assert found.probability > 0.9
    assert abs(found.first_run - 9) <= 1
    assert found.at_least <= 9 <= found.at_most
    still = made(world(), 16, np.random.default_rng(7), names=("c",)).runs
    assert find_change(still, SeriesModel(names=("c",)), "c").probability < 0.5


def test_friction_that_grows_during_runs_is_told_from_the_exponent() -> None:
    """Runs from other first amplitudes answer to it differently, which the exponent does not."""
    rng = np.random.default_rng(8)
    runs = []
    for place in range(8):
        by_growth = np.array([0.5, -1.6, 0.2]) if place % 2 else np.array([0.5, -0.4, 0.1])
        u = np.array([0.01, 0.0009, 0.05])
        runs.append(
            CompressedRun(
                label=f"run-{place}", contact="sample", names=NAMES,
                values=CENTRE + 0.02 * by_growth + u * rng.normal(size=3), covariance=np.diag(u**2),
                by_growth=by_growth, duration_s=1200.0,
            )
        )  # fmt: skip
        other = CENTRE + u * rng.normal(size=3)
        runs.append(replace(runs[-1], label=f"other-{place}", contact="other", values=other))
    # the other contact does not change
    during = Effect(parameter=FRICTION, covariate="", form=Form.DURING, contact="sample")
    model = still_model(NAMES, effects=(during,))
    found = fit_series(runs, model)
    p = found.estimate(LatentNumber("contact", "p", "sample"))
    alone = fit_series(runs, replace(model, effects=())).estimate(LatentNumber("contact", "p", "sample"))
    assert abs(alone.value - 0.94) > 15 * alone.standard_uncertainty
    assert abs(p.value - 0.94) < 3 * p.standard_uncertainty
    growth = found.estimate(LatentNumber("effect", during.label))
    assert growth.value * 1200 == pytest.approx(0.02, abs=3 * growth.standard_uncertainty * 1200)


def test_without_priors_the_data_decide() -> None:
    runs = [plain_run(-18.0 + 0.01 * i, 0.02) for i in range(6)]
    strict = SeriesModel(names=("c",), levels={"c": Estimate(-19.0, 0.02)})
    assert fit_series(runs, strict).estimate(C).value < -18.1
    assert fit_series(runs, strict.without_priors()).estimate(C).value == pytest.approx(-17.975, abs=0.02)


def test_draws_without_priors_count_where_runs_hardly_scatter() -> None:
    """The sizes are made so wide then that the scatter is 1e-4 of them."""
    runs = [plain_run(-18.0 + 0.001 * (i % 3), 0.002) for i in range(30)]
    found = fit_series(runs, SeriesModel(names=("c",)).without_priors())
    assert found.effective > 300
    assert found.estimate(LatentNumber("between runs", "c")).value < 0.003


@pytest.mark.slow
def test_a_sampler_agrees() -> None:
    pytest.importorskip("emcee")
    runs = made(world(), 8, np.random.default_rng(10), names=("c",)).runs
    model = SeriesModel(names=("c",))
    quick, sampled = fit_series(runs, model, draws=4000), sample_series(runs, model, steps=160)
    assert sampled.converged
    assert min(sampled.effective.values()) > 50
    for level in (C, LatentNumber("between runs", "c")):
        one, other = quick.estimate(level), sampled.posterior.estimate(level)
        assert other.value == pytest.approx(one.value, abs=0.15 * one.standard_uncertainty)
        assert other.standard_uncertainty == pytest.approx(one.standard_uncertainty, rel=0.15)


def test_chains_that_differ_are_told() -> None:
    rng = np.random.default_rng(11)
    chains = rng.normal(size=(4, 500, 10))
    assert split_r_hat(chains) < 1.01
    apart = chains + np.arange(4)[:, None, None]
    assert split_r_hat(apart) > 1.2


def test_a_run_as_the_series_adjusts_it_is_as_uncertain_as_its_draws() -> None:
    """Of b its u was that at a known exponent, 2.4 times too small."""
    runs, reference = made(world(), 6, np.random.default_rng(3)).runs, 3e-4
    found = fit_series(runs, SeriesModel(names=NAMES, bad_run_chance=0.0))
    values, u = found.run_values(reference)
    rng, drawn = np.random.default_rng(4), []
    shared = found.draws(LatentNumber("shared", "air"))
    for place in rng.choice(len(found.h), size=4000, p=found.weight):
        level = found.level_draws("sample")[place] + shared[place] * runs[0].shared["air"]
        between = [found.draws(LatentNumber("between runs", name))[place] for name in NAMES]
        own, prior = np.linalg.inv(runs[0].covariance), np.diag(np.array(between) ** -2.0)
        left = np.linalg.inv(own + prior)
        drawn.append(rng.multivariate_normal(left @ (own @ runs[0].values + prior @ level), left))
    by_draws = parameters(NAMES, np.array(drawn), reference)
    np.testing.assert_allclose(u[0], by_draws.std(axis=0), rtol=0.1)
    assert np.all(np.abs(values[0] - np.median(by_draws, axis=0)) < 0.2 * u[0])


def test_coordinates_return() -> None:
    names = ("b", "p", "c", "n", "period0_s", "gamma_pa")
    values = np.array([3.7e-3, 0.944, 1.05e-8, 0.092, 4.071, 28.97e6])
    found, by_parameters = to_coordinates(names, values, 3e-4)
    np.testing.assert_allclose(parameters(names, found, 3e-4), values, rtol=1e-12)
    # the logarithms of the friction by b, and of the stiffness, at the reference amplitude
    assert np.exp(found[[0, 5]]) == pytest.approx([3.7e-3 * 3e-4**-0.056, 28.97e6 * 3e-4**0.092])
    for place in range(6):
        moved = values.copy()
        step = 1e-6 * values[place]
        moved[place] += step
        slope = (to_coordinates(names, moved, 3e-4)[0] - found) / step
        np.testing.assert_allclose(by_parameters[:, place], slope, rtol=1e-4, atol=1e-6)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(DataError, match="has no finite width in c"):
        plain_run(np.nan, 0.1)
    runs = [plain_run(-18.0, 0.1)]
    with pytest.raises(DataError, match="gamma_pa: no run of the series determines it"):
        fit_series(runs, SeriesModel(names=("c", "gamma_pa")))
    with pytest.raises(DataError, match="known of 0 of 1 runs"):
        fit_series(runs, SeriesModel(names=("c",), effects=(HUMIDITY,)))
    dry = {"humidity_percent": 40.0}
    same = [plain_run(-18.0, 0.1, covariates=dry), plain_run(-18.1, 0.1, covariates=dry)]
    with pytest.raises(DataError, match="there is nothing to see"):
        fit_series(same, SeriesModel(names=("c",), effects=(HUMIDITY,)))
    growth = Effect(parameter=FRICTION, covariate="", form=Form.DURING)
    with pytest.raises(DataError, match="duration of no run is known"):
        fit_series(same, SeriesModel(names=("c",), effects=(growth,)))


def test_friction_has_a_size_of_its_own_and_none_without_priors() -> None:
    """A stated size of friction did nothing, and without priors it kept that of b where b is not modelled."""
    model = SeriesModel(names=("c",), sizes={"friction": 3.0})
    assert model.size(FRICTION) == 3.0
    assert SeriesModel(names=("b",), sizes={"b": 0.4}).size(FRICTION) == 0.4
    ageing = Effect(parameter=FRICTION, covariate="humidity_percent", form=Form.LINEAR, reference=45.0)
    humid = np.linspace(25.0, 65.0, 10)
    runs = [plain_run(-18.4 - 0.05 * (x - 45), 0.3, covariates={"humidity_percent": x}) for x in humid]
    plain = SeriesModel(names=("c",), effects=(ageing,), bad_run_chance=0.0)
    level = LatentNumber("effect", ageing.label)
    value, u = fit_series(runs, plain.without_priors()).estimate(level)
    assert value == pytest.approx(-0.05, abs=0.002)
    assert u == pytest.approx(0.3 / np.sqrt(np.sum((humid - 45.0) ** 2)), rel=0.1)


def test_a_run_that_is_left_out_keeps_its_place() -> None:
    """A step that was stated at a run moved to a later one for each run before it that could not enter."""
    runs = [
        plain_run(-18.4 + (0.5 if place >= 5 else 0.0), 0.05, covariates={ORDER: float(place)})
        for place in (0, 2, 3, 4, 5, 6, 7, 8, 9)
    ]
    step = Effect(parameter="c", covariate=ORDER, form=Form.STEP, reference=5)
    model = SeriesModel(names=("c",), bad_run_chance=0.0)
    value, u = fit_series(runs, model.with_effects(step)).estimate(LatentNumber("effect", step.label))
    assert value == pytest.approx(0.5, abs=0.5 * u)
    found = find_change(runs, model, "c")
    # counted among the runs that entered
    assert (found.first_run, found.at_least, found.at_most) == (4, 4, 4)
