"""Preparation of measurements: `rig balance` and `rig calibrate`."""

from rig.prepare.air import calibrate_air
from rig.prepare.balancing import balance_rig, show_history
from rig.prepare.calibration_inputs import Filing, next_free
from rig.prepare.calibration_report import CalibrationReport, read_calibration_report, scalar_values
from rig.prepare.dialogue import BalanceDialogue, BalanceStage, JsonReporter, Reporter, balance_dialogue
from rig.prepare.lever import calibrate_lever, check_known_angle
from rig.prepare.record_calibrations import (
    calibrate_axes,
    calibrate_clock,
    calibrate_pointing,
    calibrate_sensor,
    calibrate_shutter,
)
