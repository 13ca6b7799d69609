"""`rig calibrate`: records and tables in, one calibration file out."""

from rig.calibrate.calibrations import (
    calibrate_axes,
    calibrate_clock,
    calibrate_lever,
    calibrate_pointing,
    calibrate_sensor,
    check_known_angle,
)
from rig.calibrate.filing import Filing

__all__ = [
    "Filing",
    "calibrate_axes",
    "calibrate_clock",
    "calibrate_lever",
    "calibrate_pointing",
    "calibrate_sensor",
    "check_known_angle",
]
