"""A measurement session: preflight checks, runs, recording, end of a run, display on the terminal."""

from rig.measure.session import measure_session, resume_session, simulate_record

__all__ = ["measure_session", "resume_session", "simulate_record"]
