"""Calibrations: pixels to radians, camera clock to seconds, DN to electrons, each with its uncertainties.

scipy is imported inside functions, because the settings import this package, and an import of scipy.optimize
or scipy.stats would slow down the start of every command.
"""

from calibration.axes_fit import Axes, Sign, deflections, displacements, fit_axes
from calibration.axes_window import require_rest
from calibration.ladder import LadderSteps
from calibration.lever_fit import (
    LadderFit,
    check_scale,
    fit_ladder,
    lever_from_shifts,
    lever_from_tilts,
    moved_between,
)
from calibration.light_lever import Lever, LeverGeometry, deflection_unit, lever_from_geometry
from calibration.pointing import Stability, stability
from calibration.sensor import photon_transfer
from calibration.shutter import GLOBAL, Shutter, fit_row_time
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
