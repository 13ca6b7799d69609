"""Worlds that no law of the registry describes, or that change during a run: is b right, withheld, or wrong?

Run as ``python -m tests.benchmarks world [--quick]``. Paths
come from an integration of the tests' own (`tests.processing.fit.driven`), in air, on moving ground, seen
25 times a second with 0.005 arcsec; they go through detector, second measurement and fit as a session's do.
The air is known as it is by default, to a factor of two.

b is right within three of its standard uncertainties, drifts in the budget included; it is withheld where its
uncertainty is above `WELL_DETERMINED`.
"""

from typing import Any, NamedTuple

import numpy as np

from processing.estimate import WELL_DETERMINED, Estimate
from processing.fit import FitMethod, LinearisedFit, drift_effects
from processing.swing import turning_points
from rig.analysis.ambient import FittedDrag, evidence_of
from rig.analysis.contact_fits import fit_decay
from rig.settings import FitSettings
from tests.benchmarks.cases import each_seed, run_of
from tests.benchmarks.coverage import in_frames, rms
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import World, changing_path

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


class Case(NamedTuple):
    """A world on a ground."""

    world: str
    q: float

    @property
    def name(self) -> str:
        return f"{self.world}, q={self.q:g}"


def outcome(case: Case, seed: int) -> tuple[float, bool]:
    """From frames to the reported fit: b off over u with the budget's drifts, and whether it is withheld."""
    path = changing_path(PARAMETERS, PENDULUM, WORLDS[case.world], q=case.q, seed=seed)[2]
    drag, settings = FittedDrag(prior_s=KNOWN_S), FitSettings()
    settled = in_frames(path, [seed, 78], PENDULUM, drag)
    points = turning_points(settled.half_cycles)
    evidence = evidence_of(drag, settled.harmonics)
    fit = fit_decay(points, PENDULUM, settings, settled.exact, evidence=evidence)[0][FitMethod.EXACT]
    b, u = fit.estimate("b")
    drifts = drift_effects(LinearisedFit.of(points, PENDULUM, fit))
    u_drifts = {"ageing": settings.u_ageing, "period_drift": U_PERIOD}
    wide = np.sqrt(u**2 + sum((size * drifts[name][0]) ** 2 for name, size in u_drifts.items()))
    return (b - PARAMETERS.b) / float(wide), bool(u > WELL_DETERMINED * abs(b))


def measure(case: Case, seeds: int, first: int) -> dict[str, Any]:
    """Shares of seeds."""
    outcomes, failed = each_seed(lambda seed: outcome(case, seed), seeds, first)
    pulls, withheld = np.array(outcomes).T
    return {
        "seeds": seeds,
        "failed": failed,
        "right_or_withheld": float(np.mean((np.abs(pulls) < 3) | (withheld > 0))),
        "withheld": float(np.mean(withheld)),
        "rms_pull": float(rms(pulls)),
    }


run = run_of(measure, lambda: [Case(world, q) for world in WORLDS for q in GROUNDS], seeds=100, quick_seeds=2)
