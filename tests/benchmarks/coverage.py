"""Decays of known parameters: how often intervals hold the truth, and errors over the claimed u."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.contact import ContactParameters, PendulumOnBall
from processing.contact.laws import PAPER
from processing.deflections import DeflectionUnit
from processing.fit import FitResult, Refinement
from processing.swing import half_cycles_of_blocks
from rig.analysis import refined_half_cycles
from rig.analysis.ambient import FittedDrag
from rig.settings import FitSettings
from tests.benchmarks.cases import each_seed
from tests.processing.fit.decays import ARCSEC
from tests.processing.fit.frames import seen_in_frames
from tests.rig.analysis.spinning import Held

Floats = NDArray[np.float64]

FRAMES_PER_S, NOISE_ARCSEC = 25.0, 0.005
"""How a pendulum is seen, if nothing else is said."""

COVERAGES = (0.6827, 0.95)
"""Of the intervals of a fit."""


class Case(NamedTuple):
    """Decays of one kind: what is found of one by its seed, None if nothing; and its share of the seeds."""

    name: str
    found: Callable[[int], Mapping[str, Held] | None]
    share: float = 1.0


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds whose intervals hold the truth, errors over u, by parameter and of all together."""
    count = max(round(seeds * case.share), min(seeds, 4))
    rows, _ = each_seed(case.found, count, first)
    found = [row for row in rows if row]
    result: dict[str, Any] = {"seeds": count, "failed": count - len(found)}
    if not found:
        return result | {"one_u": dict.fromkeys(PAPER.names(), 0.0)}
    pulls = np.array([[one.pull for one in row.values()] for row in found])
    one_u, ninety_five = np.mean([[one.inside for one in row.values()] for row in found], axis=0).T
    table = {"one_u": one_u, "ninety_five": ninety_five, "rms_pull": rms(pulls)}
    result |= {key: dict(zip(found[0], values.tolist(), strict=True)) for key, values in table.items()}
    return result | {"one_u_of_all": float(np.mean(one_u)), "rms_of_all": float(rms(np.ravel(pulls)))}


def truth_of(parameters: ContactParameters, drag: bool = False) -> dict[str, float]:
    """What is true of the paper's law."""
    return {name: getattr(parameters, name) for name in PAPER.names(drag=drag)}


def of_fit(fit: FitResult, true: Mapping[str, float]) -> dict[str, Held]:
    """Errors of a fit over its uncertainties, and whether its intervals of COVERAGES hold the truth."""
    found = {}
    for name, value in true.items():
        estimate, u = fit.estimate(name)
        (low, high), (lowest, highest) = (fit.interval(name, share) for share in COVERAGES)
        found[name] = Held((estimate - value) / u, (low <= value <= high, lowest <= value <= highest))
    return found


def of_pulls(pulls: Mapping[str, float]) -> dict[str, Held]:
    """Errors over u whose intervals are those of a normal distribution."""
    return {name: Held(z, (abs(z) < 1.0, abs(z) < 1.96)) for name, z in pulls.items()}


def rms(rows: ArrayLike) -> Floats:
    """Root mean square over the seeds, the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def in_frames(
    path_rad: Floats,
    seed: Sequence[int],
    pendulum: PendulumOnBall,
    drag: FittedDrag = FittedDrag(),  # noqa: B008
) -> Refinement:
    """What a session makes of a path that a camera sees: detected, and measured again."""
    samples = seen_in_frames(path_rad, NOISE_ARCSEC * ARCSEC, list(seed), FRAMES_PER_S)
    half_cycles = half_cycles_of_blocks([samples])
    return refined_half_cycles(half_cycles, [samples], DeflectionUnit.RAD, pendulum, FitSettings(), drag=drag)
