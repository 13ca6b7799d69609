"""Rolling friction after Tomlinson: tests whether the decrement is constant and the coefficient depends on
speed.

The energy loss of a cycle divided by the angle covered is the mean moment. Divided by load and radius, it is
the coefficient of rolling friction. All three follow from the friction law fitted to the turning points.
"""

import math
from typing import NamedTuple

from processing.errors import DataError
from processing.estimate import Estimate
from processing.instruments.friction_law import FrictionLaw, fit_friction_law
from processing.swing import TurningPoints


class RollingFriction(NamedTuple):
    """Rolling friction of a decay.

    `decrement` and `coefficient` refer to `law.reference_rad`, the geometric mean of the amplitudes. The
    coefficient is proportional to amplitude^exponent, and likewise to the same power of the largest speed;
    the decrement is proportional to amplitude^(exponent - 1). Each sentence states whether one of the two
    exponents differs from zero by more than two standard uncertainties.
    """

    law: FrictionLaw
    decrement: Estimate
    coefficient: Estimate | None
    constant_decrement: bool
    independent_of_speed: bool
    sentences: tuple[str, str]


def rolling_friction(
    points: TurningPoints, lever_m: Estimate | None, radius_m: Estimate | None
) -> RollingFriction:
    """Decrement and coefficient from turning points.

    Parameters
    ----------
    lever_m
        Distance of the centre of mass below the axis of rolling; with it, moments are known relative to m g.
    radius_m
        Radius of the axis or ball that rolls. If either is None, no coefficient is computed.

    Raises
    ------
    DataError
        Too few turning points or no decay.
    """
    law = fit_friction_law(points)
    coefficient = None
    if lever_m is not None and radius_m is not None:
        if not (lever_m.value > 0 and radius_m.value > 0):
            raise DataError("lever and radius of the support must be positive")
        mean = law.mean_moment
        value = mean.value * lever_m.value / radius_m.value
        relative = math.hypot(
            mean.standard_uncertainty / mean.value,
            lever_m.standard_uncertainty / lever_m.value,
            radius_m.standard_uncertainty / radius_m.value,
        )
        coefficient = Estimate(value, value * relative)
    s, u = law.exponent
    constant, independent = abs(s - 1) <= 2 * u, abs(s) <= 2 * u
    digits = max(2, 1 - math.floor(math.log10(u))) if 0 < u < 1 else 2
    decrement = (
        f"the log decrement is {'constant' if constant else 'not constant'}: "
        f"it goes as amplitude^({s - 1:+.{digits}f} ± {u:.{digits}f})"
    )
    speed = (
        f"the rolling-friction coefficient is {'independent' if independent else 'not independent'} "
        f"of speed: it goes as amplitude^({s:.{digits}f} ± {u:.{digits}f})"
    )
    return RollingFriction(
        law, law.decrement(law.reference_rad), coefficient, constant, independent, (decrement, speed)
    )
