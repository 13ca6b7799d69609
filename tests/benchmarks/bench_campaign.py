"""Campaigns of made-up runs: are the bands as wide as they should be, are changes found?

Run as ``python -m tests.benchmarks campaign [--quick]``. The runs come
from `tests/processing/series/simulated_series.py`, which shares no formula with the analysis.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from processing.series import (
    Effect,
    Form,
    LatentNumber,
    SeriesModel,
    SeriesPosterior,
    find_change,
    fit_series,
)
from tests.processing.series.simulated_series import NAMES, Floats, Made, World, made

CENTRE = np.array([-5.6, 0.94, -18.4])
HUMIDITY = Effect(parameter="c", covariate="humidity_percent", form=Form.LINEAR, reference=45.0)
AGE = Effect(parameter="b", covariate="age_s", form=Form.LOGARITHM, reference=3600.0)
CLEANED = Effect(parameter="c", covariate="order", form=Form.STEP, reference=10.0)
RUNS = 20


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


def run(quick: bool = False) -> dict[str, Any]:
    """Of 200 campaigns each; 10 if quick."""
    count = 10 if quick else 200
    return {"coverage": coverage(count), "changes": changes(count)}
