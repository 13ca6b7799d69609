"""Series that are made up: what is true, what happens to every run, what it measures.

It knows nothing of the analysis but the class that it hands over: values are made one run after the other.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.series import CompressedRun

Floats = NDArray[np.float64]
NAMES = ("b", "p", "c")
BASEMENT_U = np.array([0.03, 0.004, 0.15])
"""Standard uncertainties of ln b (at the reference amplitude), p and ln c by one run on moving ground."""
BASEMENT_R = np.array([[1.0, 0.6, -0.5], [0.6, 1.0, -0.4], [-0.5, -0.4, 1.0]])
AIR = np.array([0.02, -0.001, 0.05])
"""What one standard uncertainty of the air does to them."""


@dataclass(frozen=True, kw_only=True)
class World:
    """What is true of a campaign; `moved` is added to a run's values, by its number and its covariates."""

    levels: Mapping[str, Floats]
    scatter: Floats
    moved: Callable[[int, Mapping[str, float]], Floats] = lambda *_: np.zeros(len(NAMES))
    air: float = 0.0
    bad: Mapping[int, float] | None = None
    """Runs that are off, and by how many times their widths."""


@dataclass(frozen=True)
class Made:
    """Runs as they were measured, and the values that they really had."""

    runs: tuple[CompressedRun, ...]
    truth: tuple[Floats, ...]


def made(
    world: World,
    count: int,
    rng: np.random.Generator,
    *,
    known_air: bool = True,
    names: tuple[str, ...] = NAMES,
) -> Made:
    """Runs over a wet and a dry season, two hours apart, contacts in turns."""
    contacts = list(world.levels)
    place = [NAMES.index(name) for name in names]
    runs, truth = [], []
    for number in range(count):
        contact = contacts[number % len(contacts)]
        covariates = {
            "humidity_percent": float(rng.uniform(25.0, 70.0)),
            "temperature_c": float(rng.normal(20.0, 0.7)),
            "age_s": 3600.0 * (1.0 + 2.0 * number),
        }
        widths = 1.0 if world.bad is None else world.bad.get(number, 1.0)
        own = world.levels[contact] + world.moved(number, covariates)
        own = own + widths * world.scatter * rng.normal(size=len(NAMES))
        size = BASEMENT_U * rng.uniform(0.7, 1.5)
        error = np.linalg.cholesky(BASEMENT_R) @ rng.normal(size=len(NAMES)) * size * widths
        seen = own + error + world.air * AIR
        runs.append(
            CompressedRun(
                label=f"run-{number + 1}",
                contact=contact,
                names=names,
                values=seen[place],
                covariance=(BASEMENT_R * np.outer(size, size))[np.ix_(place, place)],
                shared={"air": AIR[place]} if known_air else {},
                covariates=covariates,
                duration_s=1200.0,
            )
        )
        truth.append(own[place])
    return Made(tuple(runs), tuple(truth))
