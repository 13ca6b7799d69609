"""Worlds that no law of the registry describes, or that change during a run: is b right, withheld, or wrong?

Run as ``python -m tests.benchmarks world [--quick]``. Paths
come from an integration of the tests' own (`tests.processing.fit.changing`), in air, on moving ground, seen
25 times a second with 0.005 arcsec; they go through detector, second measurement and fit as a session's do.
The air is known as it is by default, to a factor of two.

b is right within three of its standard uncertainties, drifts in the budget included; it is withheld where its
uncertainty is above `WELL_DETERMINED`. A cause is named by a change that is dated, a law that is said not to
describe, residuals that are said to be no noise, or a drag that is seen; an even drift by the budget alone.
"""

from typing import Any, NamedTuple

import numpy as np

from processing.contact.laws import PAPER
from processing.deflections import DeflectionUnit
from processing.errors import RigError
from processing.estimate import WELL_DETERMINED, Estimate
from processing.fit import DragFinding, FitMethod, FitResult, drag_verdict, drifts_of
from processing.swing import TurningPoints, swings_of_blocks, turning_points
from rig.analysis import settled_swings
from rig.analysis.air import FittedDrag, evidence_of
from rig.analysis.contact_fits import fit_decay
from rig.settings import FitSettings
from tests.benchmarks.cases import chosen
from tests.benchmarks.coverage import rms
from tests.processing.fit.changing import World, changing_path
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.frames import seen_in_frames

NOISE_ARCSEC, FRAMES_PER_S = 0.005, 25.0
DRAG_S, FLAT = 1.7e-3, "glass_k8"
KNOWN_S = Estimate(1.5e-3, 0.75 * 1.5e-3)
GROUNDS = (1e-9, 8e-9)
LASTING_S, EVENT_S = 740.0, 300.0
U_PERIOD = 1.15e-5
PARAMETERS, PENDULUM = paper_pair(FLAT, DRAG_S)


def _second_term(exponent: float) -> World:
    """A tenth of b's friction at 30 arcsec, by another power."""
    return World(b2=0.1 * PARAMETERS.b * (30 * ARCSEC) ** (PARAMETERS.p - exponent), p2=exponent)


WORLDS = {
    "true law": World(),
    "v^1.5, 10 % of the loss": World(drag32=0.0151),
    "second term, power 0.5": _second_term(0.5),
    "second term, power 2": _second_term(2.0),
    "b ages by 2 %": World(ageing=0.02, lasting_s=LASTING_S),
    "period drifts by 1e-5": World(slower=1e-5, lasting_s=LASTING_S),
    "period drifts by 1e-4": World(slower=1e-4, lasting_s=LASTING_S),
    "slip of 5 %": World(event_s=EVENT_S, slip=0.05),
    "knock of 1 arcsec": World(event_s=EVENT_S, knock_rad_per_s=ARCSEC * 2 * np.pi / PARAMETERS.period0_s),
    "logarithmic damping": World(loss_angle=1e-3),
}


class Fitted(NamedTuple):
    """The fit as reported, and its points."""

    fit: FitResult
    points: TurningPoints


def fitted(world: World, q: float, seed: int) -> Fitted:
    """From frames to the reported fit."""
    path = changing_path(PARAMETERS, PENDULUM, world, q=q, seed=seed, frames_per_s=FRAMES_PER_S)[2]
    samples = seen_in_frames(path, NOISE_ARCSEC * ARCSEC, [seed, 78], FRAMES_PER_S)
    swings = swings_of_blocks([samples])
    drag, settings = FittedDrag(known_s=KNOWN_S), FitSettings()
    settled = settled_swings(swings, [samples], DeflectionUnit.RAD, PENDULUM, settings, drag=drag)
    points = turning_points(settled.swings)
    evidence = evidence_of(drag, settled.harmonics)
    fits, _, _ = fit_decay(points, PENDULUM, settings, settled.exact, evidence=evidence)
    return Fitted(fits[FitMethod.EXACT], points)


class Outcome(NamedTuple):
    """b off over its uncertainty in the fit alone and with the budget's drifts, and what is said."""

    pull: float
    pull_with_drifts: float
    relative_u: float
    withheld: bool
    named: tuple[str, ...]


def outcome(found: Fitted) -> Outcome:
    b, u = found.fit.estimate("b")
    drifts = drifts_of(found.points, PENDULUM, found.fit)
    u_drifts = {"ageing": FitSettings().u_ageing, "period_drift": U_PERIOD}
    wide = np.sqrt(u**2 + sum((size * drifts[name][0]) ** 2 for name, size in u_drifts.items()))
    named = [change.kind.value for change in found.fit.changes]
    if found.fit.misfit is not None and found.fit.misfit.seen:
        named.append("misfit")
    if found.fit.whiteness is not None and found.fit.whiteness.correlated:
        named.append("no noise")
    if drag_verdict(found.points, PENDULUM, found.fit).finding is DragFinding.SEEN:
        named.append("drag")
    off = b - PARAMETERS.b
    return Outcome(off / u, off / float(wide), u / abs(b), bool(u > WELL_DETERMINED * abs(b)), tuple(named))


def measure(name: str, q: float, seeds: int, first: int = 0) -> dict[str, Any]:
    """Shares of seeds."""
    outcomes, failed = [], 0
    for seed in range(first, first + seeds):
        try:
            outcomes.append(outcome(fitted(WORLDS[name], q, seed)))
        except RigError as error:
            failed += 1
            print(f"  seed {seed}: {error}")
    pulls = np.array([one.pull for one in outcomes])
    wide = np.array([one.pull_with_drifts for one in outcomes])
    withheld = np.array([one.withheld for one in outcomes])
    kinds = sorted({word for one in outcomes for word in one.named})
    return {
        "case": name,
        "q": q,
        "seeds": seeds,
        "failed": failed,
        "right_or_withheld": float(np.mean((np.abs(wide) < 3) | withheld)),
        "right_in_the_fit_alone": float(np.mean((np.abs(pulls) < 3) | withheld)),
        "withheld": float(np.mean(withheld)),
        "median_relative_u": float(np.median([one.relative_u for one in outcomes])),
        "rms_pull": float(rms(wide)),
        "rms_pull_in_the_fit_alone": float(rms(pulls)),
        "named": {word: float(np.mean([word in one.named for one in outcomes])) for word in kinds},
    }


def run(quick: bool = False, seeds: int = 100, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    result: dict[str, Any] = {"contact": [PAPER.name, FLAT], "cases": []}
    every = list(WORLDS)
    for name in chosen(WORLDS, only, str):
        for place, q in enumerate(GROUNDS):
            # no two cases share a seed: their seeds count together
            first = 1000 * (every.index(name) * len(GROUNDS) + place)
            found = measure(name, q, 2 if quick else seeds, first)
            result["cases"].append(found)
            print(
                f"{name}, q={q:g}, {found['seeds']} seeds ({found['failed']} failed): b right or withheld "
                f"{found['right_or_withheld']:.2f} (in the fit alone {found['right_in_the_fit_alone']:.2f}, "
                f"withheld {found['withheld']:.2f}), u(b)/b {found['median_relative_u']:.2%}, rms off/u "
                f"{found['rms_pull']:.2f} (fit alone {found['rms_pull_in_the_fit_alone']:.2f}); named "
                + ", ".join(f"{word} {share:.2f}" for word, share in found["named"].items()),
                flush=True,
            )
    return result
