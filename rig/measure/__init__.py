"""A measurement session: preflight checks, runs, recording, end of a run, display on the terminal."""

from rig.measure.end_of_run import SessionSummary, session_summary, state_of
from rig.measure.plain_record import (
    acknowledge_trip,
    light_off,
    preflight_rig,
    record_plainly,
    show_light,
    take_frames,
)
from rig.measure.posterior_worker import FIRST_HALF_CYCLES
from rig.measure.run import MIN_FREE_BYTES
from rig.measure.run_status import estimate_texts
from rig.measure.session import measure_session, resume_session, session_folder
from rig.measure.session_file import STATE_NAME, RunState, is_in_use, read_session
from rig.measure.session_list import measure_sessions
