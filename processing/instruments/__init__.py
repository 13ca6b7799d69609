"""The pendulum instruments of the paper's review: the quantities that each reports, from the turning points.

scipy is imported inside functions: the settings import the table of instruments, and importing
scipy.optimize would slow down the start of every command.
"""

from processing.instruments.crossings import circular_error, inferred_half_cycles, joined_half_cycles
from processing.instruments.damping_fit import (
    MeanOverPlaces,
    SharedError,
    ValueWithSharedErrors,
    damping,
    over_places,
    ratio,
    with_drive,
    with_shared,
)
from processing.instruments.descriptions import DEGREE_RAD, INSTRUMENTS, Check, Description, Limits, check
from processing.instruments.friction_law import (
    FrictionLaw,
    fit_friction_law,
    herbert_hardness,
    rolling_friction,
)
from processing.instruments.release import with_release
from processing.instruments.turning import refined_turning_points
