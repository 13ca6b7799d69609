"""Makes a `Law` of a `Branch`."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from processing.arrays import Floats, Ints
from processing.contact.branch import Branch
from processing.contact.branch_columns import PERIOD, BranchColumns, Scaling, Straight
from processing.contact.branch_half_swing import branch_half_swings
from processing.contact.law import DRAG, BranchMoments, HalfSwings, Law, Parameter
from processing.contact.parameters import PendulumOnBall
from processing.contact.start_values import StartValues

FREE_PERIOD = Parameter(
    PERIOD, "T₀", "s", "period without the contact's moment", "I φ'' = -m g R φ", lower=0.0
)
CONSTANT = Parameter("c", "c", "1", "constant friction, over m g R", "M = -m g R c sign(φ')", lower=0.0)


def branch_law(
    name: str,
    title: str,
    source: str,
    parameters: Sequence[Parameter],
    branch: Branch,
    scalings: Mapping[str, Scaling],
    straight: Straight,
    likely: Callable[[StartValues, float], Sequence[Mapping[str, float]]],
    *,
    in_angles: bool = False,
) -> Law:
    """A law of the registry whose half-swing map is found by quadrature.

    `likely` proposes scaled start values for a decay of the paper's form and the reference (rad). The linear
    drag of `DRAG` may be one of the parameters.
    """
    own = tuple(p.key for p in parameters if p.key not in (PERIOD, DRAG.key))

    def half_swings(values: Floats, index: Ints) -> HalfSwings:
        return branch_half_swings(branch, own, values, index)

    def moments(
        phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
    ) -> BranchMoments:
        return branch.moments(phi_rad, direction, {key: np.asarray(values[key]) for key in own}, pendulum)

    return Law(
        name=name,
        title=title,
        source=source,
        parameters=tuple(parameters),
        branch_moments=moments,
        half_swing_map=half_swings,
        columns=partial(
            BranchColumns,
            parameters=parameters,
            scalings=scalings,
            straight=straight,
            likely=likely,
            in_angles=in_angles,
        ),
    )
