"""Before a measurement: `rig balance` and `rig calibrate`."""

from rig.prepare.balancing import balance_rig, show_history
from rig.prepare.calibration_inputs import Filing, next_free
from rig.prepare.calibration_report import CalibrationReport, numbers_of, read_calibration_report
from rig.prepare.dialogue import BalanceDialogue, BalanceStage, InJsonLines, balance_dialogue
from rig.prepare.frame_times import (
    calibrate_axes,
    calibrate_clock,
    calibrate_pointing,
    calibrate_sensor,
    calibrate_shutter,
)
from rig.prepare.lever import calibrate_air, calibrate_lever, check_known_angle
