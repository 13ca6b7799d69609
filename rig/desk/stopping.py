"""Stop: a session that hears it closes its record; one that is frozen is ended as a process."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from rig.channel import NoSession
from rig.control import darken_beside

if TYPE_CHECKING:
    from rig.desk.desk import Desk

_WAKES_WITHIN_S = 10.0
"""A process that was stopped, and goes on to end, answers again by then, or is gone."""
_LOOK_S = 0.1


def stop_session(desk: "Desk", wakes_within_s: float = _WAKES_WITHIN_S) -> str:
    """Stop the session, which may be frozen; returns what was done. May wait. Raises RigError if it cannot.

    A frozen one hears no order: its light is switched off at the ports, then its process is told to end, and
    to go on if somebody has stopped it: it closes its record, if it can. What does neither is killed.
    """
    following = desk.following
    if not following.frozen:
        return following.order("stop")
    process = following.process
    if process is None:
        raise NoSession("the session does not answer, and its process is not known; end it by hand")
    problems = darken_beside(desk.config.laser, desk.config.controller)
    lit = f"; the laser may be lit: {'; '.join(problems)}" if problems else ""
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGTERM)
        if hasattr(signal, "SIGCONT"):
            # Ctrl-Z stops its helpers, too
            os.killpg(os.getpgid(process), signal.SIGCONT)
        if _within(wakes_within_s, lambda: not following.frozen):
            return f"the session was frozen; its process ends, and closes its record if it can{lit}"
        os.kill(process, getattr(signal, "SIGKILL", signal.SIGTERM))
    return f"the session was frozen; its process was killed, Resume makes the missing runs{lit}"


def _within(limit_s: float, condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(_LOOK_S)
    return True
