"""Contact of ball and flat: Hertz theory, laws of friction and elasticity, decay, period, half-cycle map."""

from processing.contact.asymptotic import decay_path, fit_decay, frequency_drop, period, period_start
from processing.contact.free_swing import (
    BOUNDARY_LAYER_DRAG,
    ExpectedDrag,
    bar_of,
    expected_drag_s,
    law_harmonics,
)
from processing.contact.half_cycle_table import (
    TABLE_RATIO,
    HalfCycleLosses,
    HalfCycleTable,
    PredictedTurningPoints,
    iterate_decay,
)
from processing.contact.hertz import (
    MATERIALS,
    Material,
    contact_radius,
    material,
    pendulum_on_ball,
)
from processing.contact.law import (
    AMPLITUDE,
    DRAG,
    STANDARD_GRAVITY_M_PER_S2,
    TIME,
    ContactParameters,
    Law,
    Parameter,
    PendulumOnBall,
    relative_curvature,
    stiffness_ratio,
    weight_moment,
)
from processing.contact.law_of_splines import MomentSplines, spline_law
from processing.contact.laws import DEFAULT_LAW, LAWS, scaled_contact, turning_points_of
from processing.contact.moments import (
    adhesive_contacts,
    measured_losses,
    model_losses,
    moment_loop,
    surface_energy,
)
from processing.contact.stated_law import StatedLaw, StatedMoment
