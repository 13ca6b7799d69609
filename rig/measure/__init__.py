"""A measurement session: preflight checks, runs, recording, end of a run, display on the terminal."""

from rig.measure.night import measure_plan
from rig.measure.resumption import resume_session
from rig.measure.session import measure_session, simulate_record

__all__ = ["measure_plan", "measure_session", "resume_session", "simulate_record"]
