"""The paper's law: friction of Eq. 1, elastic adhesion of Eq. 3.

    M_fr = -m g R (c + b |phi|^p) sign(phi')                                      (1)
    M_el = 2 gamma a^2 R |phi|^(n+1) (pi/2 - (R/a) |phi|) sign(phi)               (3)

The half-swing map is derived in `half_swing` and compiled in `half_swing_kernel`; the solver's
columns are in `half_swing_columns`, their start values in `start_values`.
"""

from collections.abc import Mapping

from processing.arrays import Floats
from processing.contact.half_swing import half_swings
from processing.contact.half_swing_columns import LARGEST, SMALLEST, HalfSwingColumns
from processing.contact.law import BranchMoments, Law, Parameter
from processing.contact.moments import elastic_moment, friction_moment
from processing.contact.parameters import ContactParameters, PendulumOnBall


def _branch_moments(
    phi_rad: Floats, direction: Floats, values: Mapping[str, float], pendulum: PendulumOnBall
) -> BranchMoments:
    """Moments of Eqs. 1 and 3, without a linear drag."""
    parameters = ContactParameters(**{name: values[name] for name in PAPER.names()})
    return BranchMoments(
        friction_moment(phi_rad, direction, parameters, pendulum),
        elastic_moment(phi_rad, parameters, pendulum),
    )


PAPER = Law(
    name="paper",
    title="friction c + b|φ|ᵖ and elastic adhesion",
    source="Eqs. 1 and 3",
    parameters=(
        Parameter("b", "b", "rad⁻ᵖ", "friction inside the contact, over m g R", "Eq. 1", lower=0.0,
                  logarithmic=True),
        Parameter("p", "p", "1", "exponent of the friction", "Eq. 1", lower=SMALLEST["p"],
                  upper=LARGEST["p"]),
        Parameter("c", "c", "1", "friction by adhesion, over m g R", "Eq. 1", lower=0.0),
        Parameter("n", "n", "1", "exponent of the elastic adhesion", "Eq. 3", lower=SMALLEST["n"],
                  upper=LARGEST["n"]),
        Parameter("period0_s", "T₀", "s", "period at vanishing amplitude", "Eq. 6", lower=0.0),
        Parameter("gamma_pa", "γ", "Pa", "stiffness of the elastic adhesion", "Eq. 3", lower=0.0,
                  logarithmic=True, shown="MPa"),
    ),
    branch_moments=_branch_moments,
    half_swing_map=half_swings,
    columns=HalfSwingColumns,
    uncalibrated={
        "gamma_pa": Parameter("kappa", "κ", "1", "2 gamma a²/(m g), per unit of amplitude to the power n",
                              "Eq. 3", lower=0.0, logarithmic=True)
    },
)  # fmt: skip
