"""The pendulum instruments of the paper's review: the quantities that each reports, from the turning points.

scipy is imported inside functions: the settings import the table of instruments, and importing
scipy.optimize would slow down the start of every command.
"""

from processing.instruments.circular import circular_error
from processing.instruments.crossings import inferred_swings, joined_swings
from processing.instruments.damping_fit import damping, over_places, ratio
from processing.instruments.descriptions import DEGREE_RAD, INSTRUMENTS, Check, Description, Limits, check
from processing.instruments.friction_law import FrictionLaw, fit_friction_law, rolling_friction
from processing.instruments.hardness import herbert_hardness
from processing.instruments.release import with_release
from processing.instruments.shared_uncertainty import Reading, SharedError, with_drive, with_shared
from processing.instruments.turning import refined
