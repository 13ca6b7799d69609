"""`rig calibrate`: makes calibration files from records and tables."""

from rig.calibrate.calibration_report import CalibrationReport, filed, numbers_of
from rig.calibrate.frame_times import (
    calibrate_axes,
    calibrate_clock,
    calibrate_pointing,
    calibrate_sensor,
    calibrate_shutter,
)
from rig.calibrate.inputs import Filing, next_free
from rig.calibrate.lever import VanesToCut, calibrate_air, calibrate_lever, check_known_angle, vanes_to_cut
