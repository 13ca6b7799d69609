"""A measurement session: preflight, runs, recorder, end of a run, what the terminal shows."""

from rig.measure.session import measure_session, resume_session, simulate_record

__all__ = ["measure_session", "resume_session", "simulate_record"]
