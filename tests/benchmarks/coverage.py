"""Decays of known parameters: how often intervals hold the truth, and errors over the claimed u."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.contact import PendulumOnBall
from processing.deflections import DeflectionUnit
from processing.fit import FitResult, Refinement
from processing.swing import swings_of_blocks
from rig.analysis import refined_half_cycles
from rig.analysis.ambient import FittedDrag
from rig.settings import FitSettings
from tests.processing.fit.decays import ARCSEC
from tests.processing.fit.frames import seen_in_frames
from tests.rig.analysis.spinning import Held

Floats = NDArray[np.float64]

FRAMES_PER_S = 25.0

COVERAGES = (0.6827, 0.95)
"""Of the intervals of a fit."""


def rms(rows: ArrayLike) -> Floats:
    """Root mean square over the seeds, the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def held(fit: FitResult, names: Sequence[str], truth: Sequence[float] | Floats) -> list[list[bool]]:
    """Whether each parameter's intervals of COVERAGES hold its true value."""
    rows = [[fit.interval(name, share) for share in COVERAGES] for name in names]
    return [[low <= true <= high for low, high in both] for both, true in zip(rows, truth, strict=True)]


def coverage(pulls: ArrayLike, inside: ArrayLike | None = None) -> dict[str, list[float]]:
    """Shares of seeds within 1 u and 95 %, and rms errors in units of u, by parameter.

    `pulls` (seeds, parameters) are errors over u, `inside` (seeds, parameters, 2) what `held` says of the
    intervals; without it they are those of a normal distribution.
    """
    z = np.asarray(pulls, dtype=np.float64)
    if inside is None:
        shares = [np.mean(np.abs(z) < 1.0, axis=0), np.mean(np.abs(z) < 1.96, axis=0)]
    else:
        shares = list(np.mean(np.asarray(inside, dtype=np.float64), axis=0).T)
    return {"one_u": shares[0].tolist(), "ninety_five": shares[1].tolist(), "rms_pull": rms(z).tolist()}


def named(names: Sequence[str], table: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """A table's rows by parameter."""
    return {key: dict(zip(names, values, strict=True)) for key, values in table.items()}


def of_reported(rows: Sequence[Sequence[Held]], names: Sequence[str], seeds: int) -> dict[str, Any]:
    """`coverage` of results as they are reported, one row for each seed that has any, by parameter."""
    found = {"one_u": [0.0] * len(names)}
    if rows:
        pulls, inside = ([[getattr(one, key) for one in row] for row in rows] for key in Held._fields)
        found = coverage(pulls, inside)
    return {"seeds": seeds, "failed": seeds - len(rows), **named(names, found)}


def of_fits(fits: Sequence[FitResult], names: Sequence[str], true: Floats) -> dict[str, dict[str, float]]:
    """`coverage` of fits whose first parameters are these, by parameter."""
    count = len(names)
    pulls = [(fit.values[:count] - true) / fit.standard_uncertainty[:count] for fit in fits]
    return named(names, coverage(pulls, [held(fit, names, true) for fit in fits]))


def in_frames(
    path_rad: Floats,
    noise_arcsec: float,
    seed: list[int],
    pendulum: PendulumOnBall,
    drag: FittedDrag = FittedDrag(),  # noqa: B008
) -> Refinement:
    """What a session makes of a path that a camera sees: detected, and measured again."""
    samples = seen_in_frames(path_rad, noise_arcsec * ARCSEC, seed, FRAMES_PER_S)
    swings = swings_of_blocks([samples])
    return refined_half_cycles(swings, [samples], DeflectionUnit.RAD, pendulum, FitSettings(), drag=drag)
