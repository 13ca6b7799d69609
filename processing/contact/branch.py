"""A law whose moment follows from the last reversal: by the distance from it and the moment there.

In a decay every reversal lies inside the one before, so that a law with memory needs no more than this. From
a reversal at the amplitude A the resisting moment, over m g R, is a function of the distance s = A - phi, and
the moment at the next reversal is the one at the end of the branch.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact.law import BranchMoments
from processing.contact.moments import weight_moment
from processing.contact.parameters import PendulumOnBall

Arrays = Mapping[str, Floats]


class Branch(NamedTuple):
    """The contact's moment over m g R from one reversal on, as functions of arrays.

    Angles are in units of a reference, which divides moments, too. `resistance` and `mean_resistance` take
    the distance from the reversal, the moment there and the parameters by key; the first is the moment
    against the motion at that distance (negative: the contact pushes), the second its mean over the way.
    `at_reversal` takes the amplitude and the parameters: the moment at a reversal if all swings were as
    large. The
    parameters include ``reference``, the unit of angles in rad. `constant` is the key of a constant friction
    beside all this, if there is one; it remembers nothing.
    """

    resistance: Callable[[Floats, Floats, Arrays], Floats]
    mean_resistance: Callable[[Floats, Floats, Arrays], Floats]
    at_reversal: Callable[[Floats, Arrays], Floats]
    constant: str = ""

    def moments(
        self, phi_rad: Floats, direction: Floats, values: Arrays, pendulum: PendulumOnBall
    ) -> BranchMoments:
        """Moments over a closed loop between the largest deflection and its opposite.

        What both directions have in common is elastic, what differs is friction.
        """
        amplitude = np.max(np.abs(phi_rad), axis=-1, keepdims=True)
        known = {**values, "reference": np.ones(())}
        # a fit may leave a parameter so small that its quotients overflow
        with np.errstate(all="ignore"):
            held = self.at_reversal(amplitude, known)
            down = self.resistance(amplitude - phi_rad, held, known)
            up = self.resistance(amplitude + phi_rad, held, known)
        weight = weight_moment(pendulum)
        friction = 0.5 * (down + up)
        if self.constant:
            friction = friction + known[self.constant]
        return BranchMoments(-weight * np.sign(direction) * friction, 0.5 * weight * (down - up))


def without_memory(constant: str = "") -> Branch:
    """No moment but what remembers nothing: a constant friction, a drag."""

    def resistance(s: Floats, held: Floats, q: Arrays) -> Floats:
        return np.zeros(np.broadcast(s, held).shape)

    return Branch(resistance, resistance, lambda amplitude, q: np.ones_like(amplitude), constant)


def masing(
    backbone: Callable[[Floats, Arrays], Floats], work: Callable[[Floats, Arrays], Floats], *, constant: str
) -> Branch:
    """Branches that are the backbone curve doubled (Masing's rule), and a constant friction beside them.

    ``M = 2 f(s/2) - M_reversal``. `work` is the integral of the backbone f.
    """

    def resistance(s: Floats, held: Floats, q: Arrays) -> Floats:
        return 2 * backbone(s / 2, q) - held

    def mean_resistance(s: Floats, held: Floats, q: Arrays) -> Floats:
        return 4 * work(s / 2, q) / s - held

    return Branch(resistance, mean_resistance, backbone, constant)
