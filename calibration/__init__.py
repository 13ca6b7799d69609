"""Calibrations: pixels to radians, camera clock to seconds, DN to electrons, each with its uncertainties.

scipy is imported inside functions: the settings import this package, and importing scipy.optimize or
scipy.stats would slow down the start of every command.
"""

from calibration.axes import Axes, deflections, displacements
from calibration.axes_fit import Sign, fit_axes
from calibration.ladder import LadderSteps
from calibration.lever_fit import (
    LadderFit,
    check_scale,
    fit_ladder,
    lever_from_shifts,
    lever_from_tilts,
    moved_between,
)
from calibration.lever_geometry import LeverGeometry, lever_from_geometry
from calibration.light_lever import Lever, deflection_unit
from calibration.oscillation import require_rest
from calibration.pointing import Stability, stability
from calibration.pulsed_shutter import PulsedShutterFit, fit_row_time_of_pulses
from calibration.sensor import photon_transfer
from calibration.shutter import GLOBAL, Shutter, ShutterFit, fit_row_time
from calibration.store import (
    CalibrationFile,
    Kind,
    Source,
    parse_calibration,
    read_calibration,
    toml_value,
    write_calibration,
)
from calibration.timebase import FRAME_JITTER_LIMIT_S, ClockRelation, relate_clocks, unwrap_counter
