"""Tables and films of other instruments become positions against time, with what is to be doubted of them."""

from rig.intake.doubts import (
    changes_in,
    cut_off,
    judge_sign,
    judge_time_unit,
    strange_amplitudes,
    why_no_laws,
)
from rig.intake.film import FilmAsked, film_trajectory, films_in, is_filmed
from rig.intake.table import TableColumns, read_columns
from rig.intake.times import fast_oscillation, fast_part, second_frequency
from rig.intake.trajectory import (
    Trajectory,
    along_and_across,
    direction_warning,
    read_positions,
    write_positions,
)
