"""Campaigns of made-up runs: are the bands as wide as they should be, are changes found, is nothing invented?

Run as ``python -m tests.benchmarks campaign [--quick]``. The runs come
from `tests/processing/series/simulated_series.py`, which shares no formula with the analysis.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr
from scipy.stats import kstest

from processing.estimate import Estimate
from processing.series import (
    SEEN,
    Effect,
    Form,
    LatentNumber,
    SeriesModel,
    SeriesPosterior,
    find_change,
    fit_series,
)
from tests.processing.series.simulated_series import NAMES, Floats, Made, World, made

LEVELS = {"b": Estimate(-5.6, 0.3), "p": Estimate(0.94, 0.02), "c": Estimate(-18.4, 0.5)}
SIZES = {"b": 0.1, "p": 0.01, "c": 0.3}
CENTRE = np.array([LEVELS[name].value for name in NAMES])
HUMIDITY = Effect(parameter="c", covariate="humidity_percent", form=Form.LINEAR, reference=45.0)
WARMTH = Effect(parameter="c", covariate="temperature_c", form=Form.LINEAR, reference=20.0)
AGE = Effect(parameter="b", covariate="age_s", form=Form.LOGARITHM, reference=3600.0)
CLEANED = Effect(parameter="c", covariate="order", form=Form.STEP, reference=10.0)
RUNS = 20


class FromPriors(NamedTuple):
    """A campaign whose truth is drawn from the priors, and that truth."""

    made: Made
    mean: Floats
    between: Floats
    scatter: Floats
    of_contact: Floats
    slope: float
    air: float


def from_priors(seed: int) -> FromPriors:
    """Four contacts of one kind; the slope's size is stated over the span of humidity that the runs have."""
    rng = np.random.default_rng([1, seed])
    mean = np.array([rng.normal(*LEVELS[name]) for name in NAMES])
    between = np.array([abs(rng.normal(0, SIZES[name])) for name in NAMES])
    scatter = np.array([abs(rng.normal(0, SIZES[name])) for name in NAMES])
    contacts = {f"contact {i}": mean + between * rng.normal(size=len(NAMES)) for i in range(4)}
    bad = {i: float(rng.choice([3.0, 10.0, 30.0])) for i in range(RUNS) if rng.uniform() < 0.02}
    air, over_span = rng.normal(), rng.normal(0, SIZES["c"])

    def campaign(slope: float) -> Made:
        world = World(
            levels=contacts,
            scatter=scatter,
            bad=bad,
            air=air,
            moved=lambda _, x: np.array([0.0, 0.0, slope * (x["humidity_percent"] - 45.0)]),
        )
        return made(world, RUNS, np.random.default_rng([2, seed]), names=("b", "c"))

    humid = [run.covariates["humidity_percent"].value for run in campaign(0.0).runs]
    slope = over_span / (max(humid) - min(humid))
    return FromPriors(
        campaign(slope), mean, between, scatter, contacts["contact 1"] - mean, slope, float(air)
    )


def calibration(count: int) -> dict[str, float]:
    """Ranks of what is true among the draws, where truth is drawn from the priors; p of their uniformity."""
    model = SeriesModel(
        names=("b", "c"), effects=(HUMIDITY,), sizes=SIZES, levels=LEVELS, contacts_alike=True
    )
    ranks: dict[str, list[float]] = {}

    def add(name: str, rank: float) -> None:
        ranks.setdefault(name, []).append(rank)

    for seed in range(count):
        truth = from_priors(seed)
        found = fit_series(truth.made.runs, model, seed=seed)
        run_values, u_runs = found.run_values
        for own, (place, name) in enumerate(((0, "b"), (2, "c"))):
            for level, value in (
                (LatentNumber("mean", name), truth.mean[place]),
                (LatentNumber("between runs", name), truth.scatter[place]),
                (LatentNumber("between contacts", name), truth.between[place]),
                (LatentNumber("contact", name, "contact 1"), truth.of_contact[place]),
            ):
                add(f"{level.kind} {name}", found.below(found.draws(level), float(value)))
            # of one run the moments are known, not draws
            pull = (truth.made.truth[3][own] - run_values[3, own]) / u_runs[3, own]
            add(f"run {name} (normal)", float(ndtr(pull)))
        add("slope", found.below(found.draws(effect_of(found)), truth.slope))
        add("air", found.below(found.draws(LatentNumber("shared", "air")), truth.air))
    return {name: float(kstest(of, "uniform").pvalue) for name, of in ranks.items()}


def effect_of(found: SeriesPosterior) -> LatentNumber:
    """The one effect of a campaign."""
    return next(level for level in found.levels if level.kind == "effect")


def coverage(count: int) -> dict[str, float]:
    """Part of campaigns whose 68 % band of an effect holds what is true."""
    cases: dict[str, tuple[Effect, float, Callable[[int, Any], Floats]]] = {
        "humidity": (HUMIDITY, -0.006, lambda _, x: np.array([0, 0, -0.006 * (x["humidity_percent"] - 45)])),
        "ageing": (AGE, 0.03, lambda _, x: np.array([0.03 * np.log(x["age_s"] / 3600), 0, 0])),
        "step": (CLEANED, 0.3, lambda i, _: np.array([0, 0, 0.3 * (i >= 10)])),
    }
    found_all = {}
    for name, (effect, slope, moved) in cases.items():
        inside = []
        for seed in range(count):
            rng = np.random.default_rng([4, seed])
            world = World(
                levels={"sample": CENTRE}, scatter=np.array([0.02, 0.002, 0.1]), moved=moved, air=rng.normal()
            )
            model = SeriesModel(names=NAMES, effects=(effect,))
            found = fit_series(made(world, RUNS, rng).runs, model, seed=seed)
            low, high = found.quantiles(found.draws(effect_of(found)), (0.16, 0.84))
            inside.append(low <= slope <= high)
        found_all[name] = float(np.mean(inside))
    return found_all


def false_slopes(count: int) -> dict[str, float]:
    """Part of campaigns without any effect in which one of three is said to be seen; stated: 5 %."""
    seen = []
    for seed in range(count):
        rng = np.random.default_rng([5, seed])
        world = World(levels={"sample": CENTRE}, scatter=np.array([0.02, 0.002, 0.1]), air=rng.normal())
        model = SeriesModel(names=NAMES, effects=(HUMIDITY, WARMTH, AGE))
        found = fit_series(made(world, RUNS, rng).runs, model, seed=seed)
        seen.append(
            any(
                found.chance(found.draws(level)) * 3 < SEEN
                for level in found.levels
                if level.kind == "effect"
            )
        )
    return {"false": float(np.mean(seen))}


def changes(count: int) -> dict[str, float]:
    """Part of campaigns in which a change of 0.5 in ln c is found, and within one run; and of false ones."""
    near, false = [], []
    model = SeriesModel(names=("c",))
    for seed in range(count):
        rng = np.random.default_rng([6, seed])
        place = int(rng.integers(4, 17))
        found = find_change(changed(place, 0.5, rng).runs, model, "c")
        near.append(found.probability > 0.5 and abs(found.first_run - place) <= 1)
        false.append(find_change(changed(place, 0.0, rng).runs, model, "c").probability > 0.5)
    return {"within_one": float(np.mean(near)), "false": float(np.mean(false))}


def changed(place: int, by: float, rng: np.random.Generator) -> Made:
    """A campaign in which ln c is another one from a run on."""
    world = World(
        levels={"sample": CENTRE},
        scatter=np.array([0.02, 0.002, 0.05]),
        moved=lambda number, _: np.array([0, 0, by * (number >= place)]),
    )
    return made(world, RUNS, rng, names=("c",))


PARTS = {
    "calibration": (calibration, 500),
    "coverage": (coverage, 200),
    "false_slopes": (false_slopes, 200),
    "changes": (changes, 200),
}
"""Each with the number of its campaigns."""


def run(quick: bool = False) -> dict[str, Any]:
    """All parts; quick for a twentieth of the campaigns."""
    return {name: part(count // 20 if quick else count) for name, (part, count) in PARTS.items()}
