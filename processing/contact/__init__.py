"""Contact of ball and flat: Hertz, laws of friction and elasticity, decay, period, half-swing map."""

from processing.contact.decay import decay_path, path_nodes
from processing.contact.half_swing import (
    relative_curvature,
    scaled_contact,
    stiffness_ratio,
    turning_points_of,
)
from processing.contact.hertz import (
    MATERIALS,
    HertzContact,
    Material,
    contact_radius,
    hertz_contact,
    material,
    pendulum_on_ball,
)
from processing.contact.laws import AMPLITUDE, DRAG, LAWS, PAPER, TIME, Law, Parameter
from processing.contact.losses import measured_losses, model_losses
from processing.contact.moments import cycle_work, moment_loop, surface_energy, weight_moment
from processing.contact.parameters import STANDARD_GRAVITY_M_PER_S2, ContactParameters, PendulumOnBall
from processing.contact.period_law import cosine_moment, frequency_drop, period
from processing.contact.quadrature import quarter_nodes

__all__ = [
    "AMPLITUDE",
    "DRAG",
    "LAWS",
    "MATERIALS",
    "PAPER",
    "STANDARD_GRAVITY_M_PER_S2",
    "TIME",
    "ContactParameters",
    "HertzContact",
    "Law",
    "Material",
    "Parameter",
    "PendulumOnBall",
    "contact_radius",
    "cosine_moment",
    "cycle_work",
    "decay_path",
    "frequency_drop",
    "hertz_contact",
    "material",
    "measured_losses",
    "model_losses",
    "moment_loop",
    "path_nodes",
    "pendulum_on_ball",
    "period",
    "quarter_nodes",
    "relative_curvature",
    "scaled_contact",
    "stiffness_ratio",
    "surface_energy",
    "turning_points_of",
    "weight_moment",
]
