"""The paper's law: friction of Eq. 1, elastic adhesion of Eq. 3.

M_fr = -m g R (c + b |phi|^p) sign(phi')                                      (1)
M_el = 2 gamma a^2 R |phi|^(n+1) (pi/2 - (R/a) |phi|) sign(phi)               (3)
"""

from processing.contact.laws.law import Law, Parameter

SMALLEST_N = 0.002
"""Below it adhesion takes almost all of the stiffness, and no data tell n from 0."""

PAPER = Law(
    name="paper",
    title="friction c + b|φ|ᵖ and elastic adhesion",
    source="Eqs. 1 and 3",
    parameters=(
        Parameter(
            "b", "b", "rad⁻ᵖ", "friction inside the contact, over m g R", "Eq. 1", lower=0.0, logarithmic=True
        ),
        Parameter("p", "p", "1", "exponent of the friction", "Eq. 1", lower=-0.5, upper=5.0),
        Parameter("c", "c", "1", "friction by adhesion, over m g R", "Eq. 1", lower=0.0),
        Parameter("n", "n", "1", "exponent of the elastic adhesion", "Eq. 3", lower=SMALLEST_N, upper=5.0),
        Parameter("period0_s", "T₀", "s", "period at vanishing amplitude", "Eq. 6", lower=0.0),
        Parameter(
            "gamma_pa", "γ", "Pa", "stiffness of the elastic adhesion", "Eq. 3", lower=0.0, logarithmic=True
        ),
    ),
    uncalibrated={
        "gamma_pa": Parameter(
            "kappa",
            "κ",
            "1",
            "2 gamma a²/(m g), per unit of amplitude to the power n",
            "Eq. 3",
            lower=0.0,
            logarithmic=True,
        )
    },
)
