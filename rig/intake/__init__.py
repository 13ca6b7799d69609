"""Tables, films and seismograms of other instruments, read as samples against time, and doubts about them.

The readers of films, which load OpenCV, are not named here: they stand in `rig.intake.film`.
"""

from rig.intake.doubts import (
    clipping_warnings,
    decay_warnings,
    judge_sign,
    judge_time_unit,
    missing_for_laws,
    strange_amplitudes,
)
from rig.intake.seismometer import FIRST_UTC_S, SeismometerRecord, read_seismometer
from rig.intake.table import TableColumns
from rig.intake.times import fast_mode_ratio, fast_oscillation
from rig.intake.trajectory import Trajectory, along_and_across, read_positions, write_positions
