"""What runs one after another tell of a contact that ages: before they are made.

In one decay amplitude and time fall together, and the exponent takes up what the age does. Runs that pass the
same amplitudes at other times tell them apart: from other first amplitudes, or after waiting.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from processing.arrays import Floats
from processing.contact import AMPLITUDE, TIME, PendulumOnBall
from processing.fit.drifts import by_drifts
from processing.fit.planning import Conditions, PlannedRun, PreparedRun, prepare_run
from processing.least_squares import covariance_of

_OWN = ("period0_s", AMPLITUDE.key, TIME.key)
_BLIND = 1e6
"""Relative uncertainty above which nothing is known: what rounding leaves of a matrix that is singular."""


@dataclass(frozen=True, slots=True)
class PlannedSeries:
    """Runs of one contact, whose friction grows evenly while they are made and while one waits.

    Attributes
    ----------
    runs
        In order; `u` of each is empty.
    waiting_s
        Between the end of one and the beginning of the next.
    u
        Of what the runs share, by parameter, at the middle of all of it, with the ageing unknown.
    u_steady
        The same for a contact that is known not to age.
    u_ageing_per_s
        Of the relative growth of the friction; infinite where the runs do not tell it.
    """

    runs: tuple[PlannedRun, ...]
    waiting_s: float
    u: Mapping[str, float]
    u_steady: Mapping[str, float]
    u_ageing_per_s: float

    @property
    def duration_s(self) -> float:
        """Of all runs with the waiting."""
        return sum(run.duration_s for run in self.runs) + self.waiting_s * (len(self.runs) - 1)


def planned_series(
    values: Mapping[str, float],
    pendulum: PendulumOnBall | None,
    conditions: Conditions,
    spans_rad: Sequence[tuple[float, float]],
    waiting_s: float = 0.0,
) -> PlannedSeries:
    """What runs between these first and last amplitudes will tell; raises as `planned_run` does.

    Every run has its own period, first amplitude and time; what is known of the air counts once.
    """
    prepared: list[PreparedRun] = []
    for first_rad, last_rad in spans_rad:
        own = conditions if not prepared else replace(conditions, known_drag_s=None)
        prepared.append(prepare_run(values, pendulum, own, first_rad, last_rad))
    names = prepared[0].model.names
    shared = [k for k, name in enumerate(names) if name not in _OWN]
    ageing = len(shared)
    ends_s = np.cumsum([run.duration_s + waiting_s for run in prepared]) - waiting_s
    lasting_s = float(ends_s[-1])
    stacked = by_shared_and_ageing(prepared, waiting_s)
    u = np.sqrt(np.diag(covariance_of(stacked)))
    steady = np.sqrt(np.diag(covariance_of(np.delete(stacked, ageing, axis=1))))
    size_of = [abs(values[names[k]]) or 1.0 for k in shared]
    keys = [names[k] for k in shared]
    told = u[ageing] if u[ageing] < _BLIND else inf
    return PlannedSeries(
        tuple(run.run({}) for run in prepared),
        waiting_s,
        dict(zip(keys, (u[:ageing] * size_of).tolist(), strict=True)),
        dict(zip(keys, (steady[:ageing] * size_of).tolist(), strict=True)),
        float(told) / lasting_s,
    )


def by_shared_and_ageing(prepared: Sequence[PreparedRun], waiting_s: float) -> Floats:
    """Derivatives of the residuals of all runs, one after the other.

    The first columns are relative changes of what the runs share, then the relative growth of the friction
    from the first turning point of all to the last, then each run's own parameters.
    """
    names = prepared[0].model.names
    shared = [k for k, name in enumerate(names) if name not in _OWN]
    ends_s = np.cumsum([run.duration_s + waiting_s for run in prepared]) - waiting_s
    ageing, width = len(shared), len(names) - len(shared)
    rows = []
    for place, (run, end_s) in enumerate(zip(prepared, ends_s.tolist(), strict=True)):
        jacobian, drifts = by_drifts(run.model.about(run.columns), run.columns, run.noise, 1.0)
        physical, to_physical = run.model.columns.physical(run.columns)
        # relative to their values, so that the columns are of one size
        size = np.where(physical == 0, 1.0, np.abs(physical))
        by_value = jacobian @ np.linalg.inv(to_physical / size[:, None])
        row = np.zeros((len(by_value), ageing + 1 + width * len(prepared)))
        row[:, :ageing] = by_value[:, shared]
        # the age of the run's middle makes all of its friction larger, a drift within it comes in addition
        later_s = end_s - 0.5 * run.duration_s - 0.5 * float(ends_s[-1])
        friction = [names.index(name) for name in ("b", "c")]
        row[:, ageing] = run.duration_s * drifts[:, :2].sum(axis=1) + later_s * by_value[:, friction].sum(
            axis=1
        )
        own_columns = slice(ageing + 1 + width * place, ageing + 1 + width * (place + 1))
        row[:, own_columns] = by_value[:, [k for k in range(len(names)) if k not in shared]]
        rows.append(row)
    stacked = np.concatenate(rows)
    # over all of it and not per second: of the size of the others
    stacked[:, ageing] /= float(ends_s[-1])
    return stacked
