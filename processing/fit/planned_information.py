"""The likelihood that a run will have, before it is made: what a campaign plans with."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, PendulumOnBall
from processing.fit.changes import by_drifts
from processing.fit.planning import Conditions, PlannedRun, prepare_run
from processing.least_squares import covariance_of


@dataclass(frozen=True, slots=True)
class PlannedLikelihood:
    """A planned run with the covariance of its parameters by its own data.

    `by_air` is the change of the values for one standard uncertainty of what is known of the drag beside the
    run, and no part of `covariance`; None: nothing is. `by_growth` is that for a relative growth of the
    friction by 1 over the run.
    """

    run: PlannedRun
    names: tuple[str, ...]
    covariance: Floats
    by_air: Floats | None
    by_growth: Floats


_SHARED = 0.9999
"""Most of the information that the air may be: what is left is the run's own."""


def planned_likelihood(
    values: Mapping[str, float],
    pendulum: PendulumOnBall | None,
    conditions: Conditions,
    first_rad: float,
    last_rad: float,
) -> PlannedLikelihood:
    """What a run between two amplitudes will say; raises as `planned_run` does."""
    prepared = prepare_run(values, pendulum, conditions, first_rad, last_rad)
    model, columns = prepared.model, prepared.columns
    jacobian, drifts = by_drifts(model.about(columns), columns, prepared.noise, 1.0)
    to_physical = model.columns.physical(columns)[1]
    covariance = to_physical @ covariance_of(jacobian) @ to_physical.T
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0] = 1.0
    by_growth = to_physical @ (np.linalg.lstsq(jacobian / norm, drifts[:, 0], rcond=1e-10)[0] / norm)
    names = model.names[:-2]
    own, moved = covariance[: len(names), : len(names)], by_growth[: len(names)]
    u = np.sqrt(np.diag(own))
    by_air = None
    if conditions.known_drag_s is not None and DRAG.key in names:
        u_known = conditions.known_drag_s.standard_uncertainty
        if u_known > 0:
            by_air = own[:, names.index(DRAG.key)] / u_known
            share = float(by_air @ np.linalg.solve(own, by_air))
            by_air = by_air * min(1.0, (_SHARED / share) ** 0.5) if share > 0 else by_air
            own = own - np.outer(by_air, by_air)
    run = prepared.run(dict(zip(names, u.tolist(), strict=True)))
    return PlannedLikelihood(run, tuple(names), 0.5 * (own + own.T), by_air, moved)
