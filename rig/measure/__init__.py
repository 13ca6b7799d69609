"""A measurement session: preflight checks, runs, recording, end of a run, display on the terminal."""

from rig.measure.end_of_session import HandOver, hand_over, state_of
from rig.measure.light_from_outside import acknowledge_trip, check_audit, show_light
from rig.measure.resuming import measure_sessions, resume_session
from rig.measure.run_panel import estimate_texts
from rig.measure.run_setup import LEAST_FREE_BYTES
from rig.measure.session import measure_session, session_folder, simulate_record
from rig.measure.session_file import STATE_NAME, RunState, SessionState, read_session
from rig.measure.without_session import preflight_rig, record_plainly, take_frames
