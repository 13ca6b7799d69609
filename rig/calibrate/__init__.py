"""The command `rig calibrate`: makes calibration files from records and tables."""

from rig.calibrate.air import VanesToCut, calibrate_air, vanes_to_cut
from rig.calibrate.filing import Filing, next_free
from rig.calibrate.frame_times import calibrate_clock, calibrate_shutter
from rig.calibrate.lever import calibrate_lever, check_known_angle
from rig.calibrate.shown import Filed, filed
from rig.calibrate.spots import calibrate_axes, calibrate_pointing, calibrate_sensor
