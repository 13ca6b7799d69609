"""Ties the frames' clock to UTC again and again, and notices steps of the computer's clock of the day."""

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from acquisition.record.events import Event, EventKind
from acquisition.record.topics import ClockAnchor
from processing.ticks import seconds
from rig.devices import kernel_clock

_PERIOD_NS = 10_000_000_000
_LEAST_STEP_NS = 2_000_000
_FASTEST_SLEW = 1e-3
"""Systems that correct their clock without a step change its rate by at most 0.5 per mille."""


class HostClockReading(NamedTuple):
    """Both clocks of the computer at the same moment, and how far apart in time they were read."""

    host_time_ns: int
    utc_ns: int
    apart_ns: int


def read_clocks() -> HostClockReading:
    """Read the clock of the day between two readings of the monotonic one."""
    before = time.monotonic_ns()
    utc_ns = time.time_ns()
    after = time.monotonic_ns()
    return HostClockReading((before + after) // 2, utc_ns, after - before)


class ClockAnchors:
    """Anchors every 10 s and after every step."""

    def __init__(self, read: Callable[[], HostClockReading] = read_clocks) -> None:
        self._read = read
        self._last: HostClockReading | None = None
        self._due_ns = 0

    def take(self, time_ns: int) -> tuple[ClockAnchor | None, list[Event]]:
        """An anchor, if one is due, and an event, if the clock of the day has stepped; `time_ns` is the time
        of the latest frame.
        """
        now, before = self._read(), self._last
        self._last = now
        events: list[Event] = []
        if before is not None:
            elapsed_ns = now.host_time_ns - before.host_time_ns
            step_ns = (now.utc_ns - before.utc_ns) - elapsed_ns
            allowed_ns = _LEAST_STEP_NS + _FASTEST_SLEW * elapsed_ns + now.apart_ns + before.apart_ns
            if abs(step_ns) > allowed_ns:
                text = f"the computer's clock of the day moved by {seconds(step_ns):+.3f} s"
                events.append(Event(time_ns, EventKind.CLOCK_STEP, text))
        if now.host_time_ns < self._due_ns and not events:
            return None, []
        self._due_ns = now.host_time_ns + _PERIOD_NS
        state = kernel_clock()
        u_utc_s = math.hypot(state.u_s, 0.5e-9 * now.apart_ns)
        return ClockAnchor(time_ns, now.host_time_ns, now.utc_ns, u_utc_s, state.synchronised), events
